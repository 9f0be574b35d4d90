"""The catalogue of effects, and what each makes of a scene's text."""

import difflib
import functools
import itertools
import math
import pickle
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from places import SCENES, cases_of, tables_of
from refusals import refusal
from validate.benches import home

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import judge
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import (
    BUILT_IN,
    BrokenEffectError,
    add,
    catalogue,
    entry_points_there_are,
    refusal_of,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)
TABLES = tables_of(__file__)

KNOWN = catalogue()
PLAIN = read_scene(SCENES / "camoo4.xml")
EDITS = [name for name, e in KNOWN.items() if e.edit is not None and e.acts_in(PLAIN)]
#: Of the others, which act on what the plain bench has not.
AT_HOME = [name for name, e in KNOWN.items() if not e.acts_in(PLAIN)]
#: Effects that change the same parts of a scene.
NEIGHBOURS = TABLES["neighbours"]
EXCLUDED = set(map(frozenset, TABLES["excluded"]))

#: Lines of scenes/camoo4.xml that an effect may take away or change; all other effects only add.
MAY_CHANGE = TABLES["may_change"]


@pytest.fixture(scope="module")
def bench(scenes):
    return read_scene(scenes / "camoo4.xml")


@pytest.fixture(scope="module")
def campaign(scenes):
    return read_campaign(scenes / "camoo4_campaign.toml")


def changes(old: str, new: str) -> tuple[list[str], list[str]]:
    """Lines taken away and lines put in."""
    lines = list(difflib.ndiff(old.splitlines(), new.splitlines()))
    return [x[2:] for x in lines if x[0] == "-"], [x[2:] for x in lines if x[0] == "+"]


def meaning(scene):
    """A scene as nested tuples in which the order of siblings does not count."""

    def of(element):
        children = tuple(sorted(map(of, element), key=repr))
        if element.tag == "transform":
            children = tuple(map(of, element))
        return element.tag, tuple(sorted(element.attrib.items())), children

    return of(scene.root)


def added(scene, *names):
    for name in names:
        scene = scene.edited(add(name, scene))
    return scene


def test_every_effect_of_the_definitions_is_there():
    assert KNOWN == BUILT_IN and list(KNOWN) == list(BUILT_IN)
    assert len(KNOWN) == 45
    for name, effect in KNOWN.items():
        assert effect.name == name
        assert (
            effect.title and len(effect.physics) > 150 and re.search(r"\d|chapter", effect.source)
        )
        assert (effect.weight is None) or effect.columns
        assert effect.family != "others" and effect.look.endswith(".") and len(effect.look) > 50
    assert KNOWN["anisotropic_scattering"].excludes == ("rayleigh_scattering",)
    ranges = {p.name: (p.minimum, p.maximum) for e in KNOWN.values() for p in e.parameters}
    assert ranges == {name: tuple(ends) for name, ends in TABLES["ranges"].items()}


@pytest.mark.parametrize("name", [*EDITS, *AT_HOME])
def test_an_effect_adds_itself_and_changes_nothing_else(name):
    bench = home(name)
    old = bench.unwritten_text or bench.path.read_text()
    new = add(name, bench)
    taken, put = changes(old, new)
    allowed = MAY_CHANGE.get(name)
    for line in taken:
        assert allowed and re.search(allowed, line.strip()), line
    assert put
    scene = bench.edited(new)
    for parameter in KNOWN[name].parameters:
        if parameter.nominal is None:
            known = scene.defaults[parameter.name]
            assert scene.parameters[parameter.name] == parameter.start
            assert known.comment.startswith(parameter.meaning)
            # haze and film bring the wavelength too, colours the width of their band besides
            own = [name for name, known in scene.defaults.items() if known.path == scene.path]
            assert parameter.name in own[-3:]
    # it is there now
    with pytest.raises(InputError):
        if name == "crystal_index":
            raise InputError("a value can be changed again", "")
        add(name, scene)


@pytest.mark.parametrize("name", AT_HOME)
def test_an_effect_is_not_put_where_it_has_nothing_to_act_on(bench, name, campaign):
    """Nor switched on there, nor a candidate; where it has, it is both."""
    for refused in (refusal(add, name, bench), refusal(campaign.with_effects, [name])):
        assert f"{name} acts on " in refused and "the scene has no" in refused
    for scene, offered in ((bench, False), (home(name), True)):
        simulations = CampaignSimulations(replace(campaign, scene=scene), Run())
        assert (name in simulations.possible()) == offered
        assert not any(name in note for note in (*simulations.notes, *simulations.refusals))


def test_effects_go_on_top_of_each_other_in_any_order(bench):
    one = {name: added(bench, name) for name in EDITS}
    pairs = {pair for group in NEIGHBOURS for pair in itertools.combinations(group, 2)}
    for pair in pairs:
        if frozenset(pair) in EXCLUDED:
            with pytest.raises(InputError, match=r"exclude each other|phase function"):
                added(one[pair[0]], pair[1])
            continue
        there, back = (added(one[a], b) for a, b in (pair, pair[::-1]))
        assert meaning(there) == meaning(back), pair


def test_all_geometric_effects_together(bench):
    names = ["edge_chamfer", "gap_bubble", "gap_thickness"]
    results = {meaning(added(bench, *order)) for order in itertools.permutations(names)}
    assert len(results) == 1
    root = added(bench, *names).root
    shapes = {shape.get("id"): shape for shape in root.iter("shape")}
    for shape, names in (
        ("crystal_bottom_bubble", "trim cut keep index"),
        ("gap_sides", "width thickness thickness_offset cut index"),
        ("gap_top_rim", "outer_width rim cut index"),
    ):
        found = {e.get("name") for e in shapes[shape].iter("float", "string")}
        assert found == set(names.split()), shape
    lowered = [n for n, s in shapes.items() if s.find("transform/scale[@z='-1']") is not None]
    assert " ".join(lowered) == (
        "window_under_gap window_under_bubble window_beside_gap window_edge_right "
        "window_edge_left window_edge_back window_edge_front detector"
    )


def test_values_are_those_asked_for(bench):
    scene = bench.edited(add("crystal_index", bench, {"n_crystal": "2.05"}))
    assert scene.parameters["n_crystal"] == 2.05
    scene = bench.edited(add("gap_thickness", bench, {"gap_offset_mm": -0.03}))
    assert scene.parameters["gap_offset_mm"] == -0.03  # a minus does no harm


@cases("name", "values", "says")
def test_what_cannot_be_added_is_refused(bench, name, values, says):
    scene = bench.with_overrides({"crystal_height_mm": 2.0}) if name == "edge_chamfer" else bench
    assert says in refusal(add, name, scene, values)


@cases("name", "old", "new", "says")
def test_scenes_of_another_form_are_refused_in_one_line(bench, name, old, new, says):
    text = bench.path.read_text()
    everywhere = name in ("gap_thickness", "gap_index", "gap_absorption")
    text = text.replace(old, new) if everywhere else text.replace(old, new, 1)
    scene = bench.edited(text)
    refused = refusal(add, name, scene)
    assert says in refused and str(bench.path) in refused


def test_parts_are_found_by_what_they_are(bench):
    text = bench.path.read_text()
    for old in ("crystal_to_air", "masked_window_to_air", "crystal_bottom", "detector", "window"):
        text = re.sub(f'id="{old}"', f'id="my_{old}"', text)
    other = bench.edited(text)
    for name in EDITS:
        add(name, other)


def test_line_ends_byte_order_mark_and_indentation_stay(bench, tmp_path):
    text = bench.path.read_text().replace("  ", "\t").replace("<scene ", "<!-- µm ü -->\n<scene ")
    path = tmp_path / "windows.xml"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    scene = read_scene(path)
    for name in EDITS:
        new = add(name, scene)
        assert new.startswith("\ufeff<?xml")
        assert new.count("\n") == new.count("\r\n")
        assert not re.search(r"^\t* +<", new.replace("\r", ""), re.MULTILINE)
        plain = new.removeprefix("\ufeff").replace("\r\n", "\n").replace("<!-- µm ü -->\n", "")
        expected = add(name, bench).replace("  ", "\t")
        assert plain.replace("  ", "\t") == expected
        scene.edited(new)


def test_scenes_on_one_line_and_without_defaults(bench, tmp_path):
    text = bench.with_overrides({}).path.read_text()
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    path = tmp_path / "flat.xml"
    path.write_text(re.sub(r"\s*\n\s*", " ", text))
    flat = read_scene(path)
    for name in EDITS:
        assert meaning(flat.edited(add(name, flat))) == meaning(added(bench, name)), name


def test_a_scene_with_an_effect_takes_its_absence():
    """What repair wrote with a collar of liquid was refused: it would be 0 mm high without it."""
    sizes = [p for effect in KNOWN.values() for p in effect.parameters if p.nominal is None]
    absent = {p.name: p.absent for p in sizes if p.absent is not None}
    assert not {name: judge(name, value) for name, value in absent.items() if judge(name, value)}


@pytest.mark.parametrize("file", ["camoo4_thin.xml", "camoo4_wrapped.xml", "cawo4.xml"])
def test_scenes_that_include_the_bench_take_effects_too(scenes, file):
    scene = read_scene(scenes / file)
    old = scene.path.read_text()
    for name in EDITS:
        if (file, name) == ("camoo4_wrapped.xml", "top_reflector"):
            assert "wrapping covers the top already" in refusal(add, name, scene)
            continue
        if (file, name) == ("camoo4_wrapped.xml", "gel_creep"):
            assert "gel_creep is for bare crystals" in refusal(add, name, scene)
            continue
        if (file, name) == ("camoo4_thin.xml", "edge_chamfer"):
            assert "crystal_chamfers" in add(name, scene)
        new = scene.edited(add(name, scene))
        assert {**new.parameters, **scene.parameters}.keys() == new.parameters.keys()
        if name in ("polarization", "crystal_index", "top_reflector"):
            taken, _ = changes(old, add(name, scene))
            assert len(taken) <= 1 and new.included == scene.included
        else:
            assert not new.included  # the bench stands in the scene now
            same = new.root.findall("shape")
            assert len(same) >= len(scene.root.findall("shape")) - 3


def test_a_reflector_lies_on_a_top_that_the_wrapping_leaves_bare(scenes, tmp_path):
    """Whether the file says so, or a parameter."""
    wrapped = (scenes / "camoo4_wrapped.xml").read_text().replace("camoo4.xml", "bench.xml")
    (tmp_path / "bench.xml").write_text((scenes / "camoo4.xml").read_text())
    path, bare = tmp_path / "scene.xml", '<string name="without" value="{}"/>\n    <bsdf type="diff'
    for given, faces in (("", "top"), ('  <default name="bare" value="top"/>\n', "$bare")):
        text = wrapped.replace('<bsdf type="diff', bare.format(faces))
        path.write_text(text.replace("  <include", f"{given}  <include"))
        assert 'id="top_reflector"' in add("top_reflector", read_scene(path))
    path.write_text(wrapped.replace('<bsdf type="diff', bare.format("sides")))
    assert "wrapping covers the top already" in refusal(add, "top_reflector", read_scene(path))


@pytest.mark.parametrize("height_mm", [15.0, 60.0, 200.0])
def test_a_reflector_on_a_tall_crystal_is_told_from_its_top(scenes, height_mm):
    tall = read_scene(scenes / "lyso_sipm.xml", {"crystal_height_mm": height_mm})
    assert Simulation(tall.edited(add("top_reflector", tall))).model.faces


def test_an_included_file_of_another_folder_is_named(tmp_path, bench):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/bench.xml").write_text(bench.path.read_text())
    path = tmp_path / "scene.xml"
    path.write_text('<scene version="3.0.0">\n  <include filename="parts/bench.xml"/>\n</scene>\n')
    scene = read_scene(path)
    refused = refusal(add, "source_depth", scene)
    place = f"{tmp_path / 'parts/bench.xml'}, line 67: what the effect changes is"
    assert refused.startswith(place) and "add the effect to this file" in refused
    assert scene.edited(add("crystal_index", scene)).parameters["n_crystal"] == 2.04


def test_mitsuba_loads_a_text_that_was_never_written(scenes):
    scene = read_scene(scenes / "cawo4.xml")
    with_top = scene.edited(add("top_reflector", scene))
    assert with_top.unwritten_text is not None and scene.unwritten_text is None
    assert with_top.content_hash != scene.content_hash
    again = pickle.loads(pickle.dumps(with_top.with_overrides({"top_reflectance": 0.9})))
    simulation = Simulation(again, check=False)
    found = {shape.id() for shape in simulation.scene.shapes()}
    assert {"top_reflector", "detector"} <= found
    assert simulation.file.parameters["top_reflectance"] == 0.9


PARAMETERS = {
    "crystal_height_mm": 10.0,
    "crystal_width_mm": 10.0,
    "n_gap": 1.46,
    "aperture_radius_mm": 7.0,
}


def factor(name, values, parameters=PARAMETERS, **columns):
    arrays = {key: np.asarray(value, dtype=np.float32) for key, value in columns.items()}
    return KNOWN[name].weight(arrays, values, parameters)


def test_weights_are_ratios_of_densities():
    depths = np.linspace(0, 10, 200_001)
    for depth in (0.2, 2.0, 100.0):
        density = factor("source_depth", {"source_depth_mm": depth}, birth_depth_mm=depths)
        assert np.trapezoid(density, depths) / 10 == pytest.approx(1, abs=1e-4)
        assert density[2000] / density[0] == pytest.approx(
            math.exp(-depths[2000] / depth), rel=1e-4
        )
    assert np.all(factor("source_depth", {"source_depth_mm": math.inf}, birth_depth_mm=[0, 9]) == 1)
    from_side = factor("side_source", {"side_depth_mm": 2.0}, birth_side_mm=depths)
    assert np.all(
        from_side == factor("source_depth", {"source_depth_mm": 2.0}, birth_depth_mm=depths)
    )
    gap, air = {"gap_absorption_per_cm": 2.0}, {**PARAMETERS, "n_gap": 1.0}
    assert factor("gap_absorption", gap, air, path_gap_cm=[0.5]) == pytest.approx([1])
    for name, values, columns, expected in (
        ("surface_absorption", {"surface_loss": 0.1}, {"reflections": [0, 2]}, [1, 0.81]),
        ("ground_loss", {"ground_loss": 0.1}, {"rough_hits": [0, 2]}, [1, 0.81]),
        ("gap_absorption", gap, {"path_gap_cm": [0.5]}, [math.exp(-1)]),
        ("detector_angle", {"angular_falloff": 0.4}, {"arrival_cosine": [1, 0.5]}, [1, 0.8]),
        ("detector_angle", {"angular_falloff": -1}, {"arrival_cosine": [1, 0.5]}, [1, 1.5]),
        ("detector_specular", {"detector_specular": 0.25}, {"detector_hits": [0, 2]}, [1.5, 0.375]),
        ("housing_reflection", {"housing_reflectance": 0.1}, {"mask_hits": [0, 2]}, [1, 0.25]),
        ("detector_radius", {"radial_falloff": 1}, {"arrival_radius_mm": [7, 19]}, [0.75, 0]),
        ("top_reflector", {"top_reflectance": 0.0}, {"reflector_hits": [0, 1]}, [1, 0]),
        (
            "detector_reflection",
            {"detector_reflectance": 0.25},
            {"detector_hits": [0, 2]},
            [1.5, 0.375],
        ),
        ("rayleigh_scattering", {}, {"log_rayleigh": [math.log(1.5)]}, [1.5]),
        ("aperture_at_detector", {}, {"arrival_radius_mm": [6.9, 7.1]}, [1, 0]),
    ):
        assert factor(name, values, **columns) == pytest.approx(expected), name


@pytest.mark.parametrize(
    "name", [n for n, e in KNOWN.items() if e.reading and e.parameters[0].absent == 0.0]
)
def test_readings_and_their_slopes(name):
    signals, value, step = np.array([0.5, 20.0, 3.0]), 0.01, 1e-6
    rows = Rows(np.array([-0.5, 0.0, 0.5]), np.array([False, True, True]))

    def read(signals, value):
        return KNOWN[name].reading(signals, value, rows)

    reading, by_signal, by_value = read(signals, value)
    assert read(signals, 0.0)[0] == pytest.approx(signals)
    up, down = (read(signals + s, value)[0] for s in (step, -step))
    assert by_signal == pytest.approx((up - down) / (2 * step), rel=1e-6)
    up, down = (read(signals, value + s)[0] for s in (step, -step))
    assert by_value == pytest.approx((up - down) / (2 * step), rel=1e-6)
    # several sizes at once, as predictions of many points take them
    both = read(np.stack([signals, signals]), np.array([[value], [0.0]]))[0]
    assert both == pytest.approx(np.stack([reading, signals]))


def test_what_drifts_and_what_another_crystal_reads():
    signals = np.array([10.0, 10.0, 10.0])
    rows = Rows(np.array([-0.5, 0.0, 0.5]), np.array([False, True, True]))
    assert KNOWN["gain_drift"].reading(signals, 0.1, rows)[0] == pytest.approx([9.5, 10.0, 10.5])
    assert KNOWN["sample_scale"].reading(signals, 0.1, rows)[0] == pytest.approx([10.0, 11, 11])
    # the yield comes first; what drifts is what is read in the end
    last = sorted((e for e in KNOWN.values() if e.reading), key=lambda e: e.order)
    names = ["sample_scale", "non_proportionality", "nonlinearity", "cell_saturation"]
    names += ["background", "gain_drift"]
    assert [e.name for e in last] == names


def test_cells_that_have_fired_are_dead():
    """As photoelectrons fall on cells; with slopes, of any number of cells."""
    cells, rng = 400, np.random.default_rng(4)
    true, nothing = np.array([20.0, 200.0, 900.0]), Rows(np.zeros(0), np.zeros(0, dtype=bool))
    reading = KNOWN["cell_saturation"].reading
    read, by_true, by_value = reading(true, cells, nothing)
    for number, mean in zip(true, read, strict=True):
        fell = (rng.integers(cells, size=rng.poisson(number)) for _ in range(2000))
        fired = np.array([len(np.unique(some)) for some in fell])
        assert mean == pytest.approx(fired.mean(), abs=4 * fired.std() / math.sqrt(2000))
    above, below = (reading(true + step, cells, nothing)[0] for step in (1e-4, -1e-4))
    assert by_true == pytest.approx((above - below) / 2e-4, rel=1e-6)
    above, below = (reading(true, cells + step, nothing)[0] for step in (1e-3, -1e-3))
    assert by_value == pytest.approx((above - below) / 2e-3, rel=1e-4)


def test_a_nonlinear_readout_divides_by_nothing_and_rises_on():
    """reading = true / (1 + k true) up to ten times the light, and straight on from there."""
    reading = KNOWN["nonlinearity"].reading
    true, nothing = np.geomspace(1e-3, 1e4, 400), Rows(np.zeros(0), np.zeros(0, dtype=bool))
    sizes = [[-0.05], [-0.004], [0.0], [0.004], [0.05]]
    for value in (*(size for (size,) in sizes), np.array(sizes)):
        read, by_true, by_value = reading(true, value, nothing)
        formula = np.broadcast_to(1.0 + value * true, read.shape)
        inside = formula > 0.1
        assert inside.any() and read[inside] == pytest.approx((true / formula)[inside])
        assert np.isfinite(read).all() and (np.diff(read) > 0.0).all() and (by_true > 0.0).all()
        up, down = (
            reading(true * 1.0001, value, nothing)[0],
            reading(true * 0.9999, value, nothing)[0],
        )
        assert by_true == pytest.approx((up - down) / (2e-4 * true), rel=0.01)
        up, down = (reading(true, value + step, nothing)[0] for step in (1e-8, -1e-8))
        assert by_value == pytest.approx((up - down) / 2e-8, rel=0.01)
    (beside,) = KNOWN["nonlinearity"].beside(np.array([5.0, 40.0])).parameters
    assert beside.plausible_in({}) == (-0.1 / 40.0, 0.2 / 40.0)
    (tiny,) = KNOWN["background"].beside(np.array([3e-20, 5e-19])).parameters  # coulombs
    assert tiny.range_in({}) == (0.0, -3e-20, 3e-20)


def test_the_old_name_of_an_effect_is_read_and_taken(bench, tmp_path):
    assert "nonlinearity belongs to the readings" in refusal(add, "saturation", bench)
    (tmp_path / "spot.py").write_text(
        OWN.replace("edit=edit", "edit=edit, excludes=('saturation',)")
    )
    assert catalogue(tmp_path)["spot"].excludes == ("nonlinearity",)
    for old, says in (
        ('"spot", title', "an effect saturation exists already"),
        ('"spot_mm", unit', "saturation is a parameter of nonlinearity already"),
    ):
        (tmp_path / "spot.py").write_text(OWN.replace(old, f'"saturation",{old.split(",")[1]}'))
        assert says in refusal(catalogue, tmp_path)


OWN = """from mcrim_mitsuba.effects import Effect, EffectParameter


def edit(editor):
    editor.insert_shape(
        '<shape type="disk" id="spot">\\n  <float name="radius" value="$spot_mm"/>\\n</shape>',
        after=editor.crystal_faces[0],
    )


EFFECT = Effect(
    name="spot", title="Black spot", physics="...", source="...",
    parameters=(
        EffectParameter(
            name="spot_mm", unit="mm", meaning="Radius of the spot", minimum=0, maximum=5,
            start=1, plausible=(0, 3), nodes=(1, 2, 4),
        ),
    ),
    edit=edit,
)
"""


def test_a_users_own_effect(bench, tmp_path):
    (tmp_path / "spot.py").write_text(OWN)
    (tmp_path / "_helper.py").write_text("raise RuntimeError")
    (tmp_path / "notes.txt").write_text("no effect")
    known = catalogue(tmp_path)
    assert list(known)[-1] == "spot" and len(known) == len(BUILT_IN) + 1
    taken, put = changes(bench.path.read_text(), add("spot", bench, {"spot_mm": 2}, tmp_path))
    assert not taken
    assert "  <!-- Radius of the spot, mm: 0 to 5 -->" in put
    assert '    <float name="radius" value="$spot_mm"/>' in put
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "_helper.py",
        "notes.txt",
        "spot.py",
    ]


@cases("old", "new", "line", "says")
def test_a_broken_file_is_named_with_its_line(tmp_path, old, new, line, says):
    assert old in OWN
    (tmp_path / "spot.py").write_text(OWN.replace(old, new, 1))
    refused = refusal(catalogue, tmp_path)
    assert refused.startswith(f"{tmp_path / 'spot.py'}, line {line}: ") and says in refused


def power(signals, value, *, scale=1.0):
    """A readout that leaves signals of 1 as they are."""
    read = scale * (signals / scale) ** (1 + value)
    return read, (1 + value) * read / signals, read * np.log(signals / scale)


@pytest.mark.parametrize("reading", [power, functools.partial(power, scale=2.0)])
def test_a_reading_of_one_s_own_is_tried_and_kept_in_copies(campaign, reading):
    number = {"minimum": -0.5, "maximum": 0.5, "start": 0.05, "plausible": (-0.2, 0.2), "nodes": ()}
    size = EffectParameter(
        name="power", meaning="x", **number, plausible_beside=lambda signals: (-0.1, 0.1)
    )
    own = Effect("power", "x", "x", "x", parameters=(size,), reading=reading)
    mine = replace(campaign, catalogue={**campaign.catalogue, "power": own})
    assert "power" in CampaignSimulations(mine, Run()).possible()
    signals, rows = np.array([2.0, 30.0]), Rows(np.zeros(2), np.zeros(2, bool))
    copy = own.beside(signals).beside(signals)
    assert copy.parameters[0].plausible == (-0.1, 0.1)
    assert np.array_equal(copy.reading(signals, 0.1, rows), reading(signals, 0.1))


def test_nothing_to_load_is_said(tmp_path):
    for folder, says in [(tmp_path, "there is no effect"), (tmp_path / "no", "not a folder")]:
        assert says in refusal(catalogue, folder)


def test_an_effect_that_contradicts_itself_is_refused():
    numbers = {"minimum": 0, "maximum": 1, "start": 0.5, "plausible": (0, 0.5)}
    number = EffectParameter(name="x_mm", unit="mm", meaning="x", nodes=(0.5, 1), **numbers)
    assert number.coordinate_of(0.5) == 0.5
    with pytest.raises(ValueError, match="ends an XML comment"):
        EffectParameter(name="x", meaning="a -- b", nodes=(), **numbers)
    with pytest.raises(ValueError, match="proposal must give"):
        Effect("x", "x", "x", "x", parameters=(number,), weight=len, proposal={"y": 1.0})


@cases("wrong", "says")
def test_what_is_wrong_in_a_user_s_effect_is_said_of_its_file(tmp_path, wrong, says):
    own = (SCENES / "own_effects" / "black_spot.py").read_text()
    start = own.index("def edit(editor):")
    end = own.index("EFFECT = ")
    (tmp_path / "black_spot.py").write_text(
        own[:start] + f"def edit(editor):\n    {wrong}\n\n\n" + own[end:]
    )
    effect = catalogue(tmp_path)["black_spot"]
    with pytest.raises(InputError, match=says):
        add(effect, read_scene(SCENES / "camoo4.xml"))


def test_why_an_effect_is_refused_is_asked_again_where_something_has_changed(tmp_path):
    """Of scenes that say the same it is known, and costs nothing."""
    tried = []

    def edit(editor):
        tried.append(editor)
        if editor.scene.parameters["gap_mm"] > 0.1:
            raise InputError("the gap is wide", "make it narrow")

    own = Effect("x", "x", "x", "x", edit=edit)
    path = tmp_path / "bench.xml"
    path.write_text(text := (SCENES / "camoo4.xml").read_text())
    assert [refusal_of(own, read_scene(path)) for _ in range(2)] == [None] * 2 and len(tried) == 1
    assert refusal_of(own, read_scene(path, {"gap_mm": 0.2})) == "the gap is wide"
    path.write_text(re.sub('(name="gap_mm" value=)"[^"]*"', r'\1"0.3"', text))
    assert refusal_of(own, read_scene(path)) == "the gap is wide" and len(tried) == 3
    assert refusal_of(replace(own, edit=lambda editor: None), read_scene(path)) is None


def test_what_is_wrong_in_an_edit_with_arguments_is_said_of_its_file(bench):
    def edit(editor, name):
        editor.by_id[name]

    effect = Effect("x", "x", "x", "x", edit=functools.partial(edit, name="cristal"))
    with pytest.raises(
        BrokenEffectError, match=r"test_effects\.py, line \d+: .*KeyError: 'cristal'"
    ):
        add(effect, bench)


@pytest.fixture
def distribution(tmp_path, monkeypatch):
    """Writes a distribution with one entry point, installed as far as Python can tell."""

    def install(point, module=OWN):
        (tmp_path / "spots.py").write_text(module)
        info = tmp_path / "mcrim_spots-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mcrim-spots\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[mcrim_mitsuba.effects]\nspot = {point}\n")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "spots", raising=False)
        entry_points_there_are.cache_clear()

    yield install
    entry_points_there_are.cache_clear()


@pytest.mark.parametrize("point", ["spots", "spots:EFFECT"])
def test_an_effect_of_an_installed_distribution(bench, distribution, point):
    distribution(point)
    assert list(catalogue()) == [*BUILT_IN, "spot"]
    assert 'name="spot_mm" value="2.0"' in add("spot", bench, {"spot_mm": 2.0})


@pytest.mark.parametrize(
    ("point", "module", "says"),
    [
        ("spot", OWN, "ModuleNotFoundError: No module named 'spot'"),
        ("spots", "import sys; sys.exit('no')", "SystemExit: no"),
        ("spots:edit", OWN, "spots:edit is of type function, not Effect"),
        ("spots", OWN.replace('"spot", t', '"gap_bubble", t'), "an effect gap_bubble exists"),
        ("spots", OWN.replace("edit=edit", "edit=edit, excludes=('spott',)"), "did you mean spot?"),
    ],
)
def test_a_broken_distribution_is_named(distribution, point, module, says):
    distribution(point, module)
    with pytest.raises(InputError) as refusal:
        catalogue()
    assert str(refusal.value).startswith("distribution mcrim-spots: ")
    assert says in str(refusal.value) and "\n" not in str(refusal.value)


#: Effects that are written for a box.
OF_A_BOX = "edge_chamfer gap_bubble gap_bubble_round gap_thickness gel_creep top_reflector".split()


@pytest.mark.parametrize("form", ["cylinder", "cylinder_lying", "hexagonal", "pyramid"])
def test_effects_on_a_crystal_that_is_no_box(scenes, form):
    """What needs no box is added; the rest is refused in a line that says why."""
    scene = read_scene(scenes / f"camoo4_{form}.xml")
    refused = {}
    for name in EDITS:
        try:
            add(name, scene)
        except InputError as error:
            refused[name] = error.problem
    reasons = dict.fromkeys(OF_A_BOX, "the scene has no parameter crystal_width_mm")
    if form == "cylinder_lying":
        for name in ("top_roughness", "ground_top"):
            reasons[name] = "the crystal has no top face of its own"
    assert refused == reasons


@pytest.mark.parametrize("bottom", [False, True])
def test_the_face_above_a_bubble_is_as_the_bottom_where_all_others_are_ground(bottom):
    """Others' facets were written beside its own, which Mitsuba refuses, or in place of none."""
    grounds = ["ground_side", "ground_top", *(["ground_bottom"] if bottom else [])]
    scene = added(PLAIN, *grounds, "gap_bubble")
    worn = scene.parts.by_id["crystal_bottom_bubble"].find("ref[@id]").attrib["id"]
    alphas = [part.attrib["value"] for part in scene.parts.by_id[worn].iter("float")]
    names = [part.attrib["name"] for part in scene.parts.by_id[worn].iter("float")]
    assert len(names) == len(set(names))
    alpha = dict(zip(names, alphas, strict=True))["roughness_alpha"]
    assert float(alpha) == (scene.parameters["ground_bottom_alpha"] if bottom else 0.0)
