"""Effects in volumes, at surfaces, in the emitter and at the detector, as the kernel follows them.

Closed forms, and one run's records reweighted against a run of their own for the same effect: an
error of either would show. Statistical tests have fixed seeds and compare at z < 4; with some
seventy comparisons a correct program would fail this file with a probability of 0.5 %.
"""

import drjit as dr
import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_compatible, assert_same_light, eta_slope
from places import cases_of, tables_of
from scipy.integrate import quad
from scipy.stats import kstest

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.optics.emission_band import scattering_of_colours
from mcrim_mitsuba.optics.thin_film import ThinFilm, cathode_index
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport import collection, dielectric, surface_physics
from mcrim_mitsuba.transport import loop as transport
from mcrim_mitsuba.transport.bulk import henyey_greenstein_cosine, lane_generators, rayleigh_cosine
from mcrim_mitsuba.transport.collection import Recorder
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals, plan_lanes
from mcrim_mitsuba.transport.record_store import COLUMNS, TrailStore
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import use_variant

cases = cases_of(__file__)
TABLES = tables_of(__file__)

Z = 4.0
GEL = {"n_gap": 1.46}
KNOWN = catalogue()
#: Wider than the window: nothing is masked.
NO_MASK = {"aperture_radius_mm": 30}

_CRYSTAL = '<float name="alpha_abs_per_cm" value="$alpha_abs_per_cm"/>\n'
#: Effects of the catalogue, by the words below, and their sizes.
EFFECTS = TABLES["effects"]
#: A crystal in which all light is detected: its faces are the detector.
BOX = """<scene version="3.0.0">
  <default name="alpha_scat_per_cm" value="3"/><default name="q" value="0"/>
  <integrator type="light_collection"/>
  <medium type="bulk" id="crystal"><float name="alpha_scat_per_cm" value="$alpha_scat_per_cm"/>
    <float name="scattering_gradient" value="$q"/>{phase}</medium>
  <emitter type="scintillation"><ref id="crystal"/></emitter>
  <shape type="cube" id="box"><transform name="to_world"><scale value="5"/><translate z="7"/>
    </transform><bsdf type="photodetector"/><ref name="interior" id="crystal"/></shape></scene>"""
HG = '<phase type="hg"><float name="g" value="{}"/></phase>'


@pytest.fixture
def bench(scenes, tmp_path):
    """Loads the bench with some effects in it."""

    def load(effects="", overrides=None, edits=()) -> Simulation:
        scene = read_scene(scenes / "camoo4.xml")
        for name in effects.split():
            for effect, values in EFFECTS[name].items():
                scene = scene.edited(add(effect, scene, values))
        text = scene.unwritten_text or scene.path.read_text()
        for old, new in edits:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        path = tmp_path / f"{effects.replace(' ', '_') or 'plain'}.xml"
        path.write_text(text)
        return Simulation(path, overrides, check=False)

    return load


def boxed(tmp_path, phase="", **overrides) -> Simulation:
    path = tmp_path / "box.xml"
    path.write_text(BOX.format(phase=phase))
    return Simulation(path, overrides, check=False)


def record(simulation, columns=(), *, seed, launches=24, alpha_scat=0.54, alpha_abs=0.039):
    return Recorder(simulation).record(
        ScatteringProposals((alpha_scat,), (SHARE_STEPS,), alpha_abs),
        launches * LANES,
        seed=seed,
        number=0,
        columns=columns,
    )


def mean_per_photon(records, values):
    """Mean over all photons of a value that the detected ones have, and its standard error."""
    sums = np.bincount(records.batch, np.asarray(values, dtype=float), records.batches)
    each = sums * records.batches / records.photons
    return each.mean(), each.std(ddof=1) / np.sqrt(len(each))


def assert_eta(records, factor, result):
    """Eta of records with a further weight agrees with a run of its own."""
    eta, sigma = mean_per_photon(records, records.w * factor)
    assert_compatible(eta, sigma, result.eta, result.eta_sigma, z_max=Z)


# ---- scattering in volumes ----------------------------------------------------------------------


@pytest.mark.parametrize("g", [-0.5, 0.0, 1e-4, 0.3, 0.95])
def test_henyey_greenstein_angles_have_their_distribution(g):
    mi = use_variant()
    even = (np.arange(100_000) + 0.5) / 50_000 - 1
    cosine = np.array(henyey_greenstein_cosine(mi.Float(even), mi.Float(g)), dtype=float)
    assert np.abs(cosine).max() <= 1
    assert cosine.mean() == pytest.approx(g, abs=1e-5)
    if abs(g) > 1e-3:
        below = (1 - g * g) / (2 * g) * ((1 + g * g - 2 * g * cosine) ** -0.5 - 1 / (1 + g))
    else:
        below = (1 + cosine) / 2
    assert np.abs(below - (1 + even) / 2).max() < 1e-4


def test_rayleigh_angles_have_their_distribution():
    mi = use_variant()
    even = (np.arange(100_000) + 0.5) / 50_000 - 1
    cosine = np.array(rayleigh_cosine(mi.Float(even)), dtype=float)
    assert np.abs(3 / 8 * (cosine + cosine**3 / 3) - even / 2).max() < 1e-6


@pytest.mark.parametrize("phase", ["isotropic", "rayleigh", -0.5, 0.8])
def test_angles_are_about_the_direction_of_flight(tmp_path, phase):
    """Where all light is detected, a scattering's mean log(3/4 (1 + cos^2)) is the phase's own."""
    g = 0.0 if isinstance(phase, str) else phase
    simulation = boxed(tmp_path, HG.format(g) if g else f'<phase type="{phase}"/>')
    records = record(simulation, ("log_rayleigh",), seed=1, launches=8, alpha_scat=3, alpha_abs=0)
    assert len(records.k) == records.photons

    def density(c):
        if phase == "rayleigh":
            return 3 / 8 * (1 + c * c)
        return 0.5 * (1 - g * g) * (1 + g * g - 2 * g * c) ** -1.5

    expected, _ = quad(lambda c: density(c) * np.log(0.75 * (1 + c * c)), -1, 1)
    excess = records.further["log_rayleigh"] - expected * records.k
    mean, sigma = mean_per_photon(records, excess)
    assert abs(mean) < Z * sigma
    # forward scattering lets light out sooner; of isotropic scattering there are 1.77
    scatterings, sigma = mean_per_photon(records, records.k)
    assert (scatterings < 1.7) == (g > 0) and (scatterings > 1.9) == (g < 0)


@pytest.mark.parametrize("q", [1.0, -0.7])
def test_free_paths_in_a_graded_crystal(tmp_path, q):
    simulation = boxed(tmp_path, q=q)
    records = record(simulation, seed=2, launches=8, alpha_scat=3, alpha_abs=0)
    weighted = records.further["scattering_path_cm"].astype(float)
    # scatterings come at the rate that the weighted path says, whatever was scattered before
    excess, sigma = mean_per_photon(records, records.k - 3 * weighted)
    assert abs(excess) < Z * sigma
    # and straight light is what is left of a straight line through the crystal
    rng = np.random.default_rng(3)
    start, direction = rng.random((400_000, 3)) * 10 - 5, rng.standard_normal((400_000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    length = ((np.sign(direction) * 5 - start) / direction).min(axis=1)
    strength = 1 + q / 5 * (start[:, 2] + 0.5 * length * direction[:, 2])
    straight = np.exp(-0.3 * strength * length)
    ours, sigma = mean_per_photon(records, records.k == 0)
    sigma = np.hypot(sigma, straight.std() / np.sqrt(len(straight)))
    assert abs(ours - straight.mean()) < Z * sigma


def test_a_graded_crystal_answers_for_other_coefficients_and_slopes(bench):
    """By the weighted path; and automatic differentiation knows of it."""
    simulation = bench("gradient", GEL)
    records = record(simulation, seed=4)
    k, weighted = records.k, records.further["scattering_path_cm"]
    direct = bench("gradient", {"alpha_scat_per_cm": 0.3} | GEL).collect(400_000, seed=5)
    assert_eta(records, (0.3 / 0.54) ** k * np.exp(0.24 * weighted), direct)
    slope, sigma = mean_per_photon(records, records.w * (k / 0.54 - weighted))
    automatic, error = eta_slope(simulation, "alpha_scat_per_cm", photons=400_000, seed=6)
    assert abs(automatic - slope) < Z * np.hypot(sigma, error)
    assert abs(slope) > 10 * sigma


def test_colours_scatter_by_their_wavelengths(bench):
    """Against single wavelengths, and the NumPy tracer, which draws them itself."""
    gap, alpha_scat = GEL, 0.54
    own = bench("colours", {"alpha_scat_per_cm": alpha_scat} | gap)
    drawn = own.collect(400_000, seed=1)
    parts, factors = scattering_of_colours(4.0, 540.0, 150.0)
    each = [
        bench("", {"alpha_scat_per_cm": alpha_scat * float(factor)} | gap).collect(200_000, seed=2)
        for factor in factors
    ]
    mean = sum(part * one.eta for part, one in zip(parts, each, strict=True))
    # those of one seed go together: their errors add up
    sigma = sum(part * one.eta_sigma for part, one in zip(parts, each, strict=True))
    assert_compatible(drawn.eta, drawn.eta_sigma, mean, sigma, z_max=Z)
    known = bench_scene(alpha_scat_per_cm=alpha_scat, scattering_exponent=4.0, **gap)
    numpy = trace(known, 60_000, 3)
    assert_compatible(drawn.eta, drawn.eta_sigma, numpy.eta, numpy.eta_sigma, z_max=Z)


def test_only_light_that_is_born_in_a_volume_has_its_colours(scenes, tmp_path):
    """As docs/parts.md says; a window's exponent changed what the crystal's light scattered."""
    scattering = """<medium type="bulk" id="window"><float name="alpha_scat_per_cm" value="5"/>
      <float name="scattering_exponent" value="{}"/></medium>"""
    text, path = (scenes / "camoo4.xml").read_text(encoding="utf-8"), tmp_path / "window.xml"
    etas = []
    for power in (0, 4):
        window = scattering.format(power)
        path.write_text(text.replace('<medium type="bulk" id="window"/>', window))
        etas.append(Simulation(path).collect(20_000, seed=1).eta)
    assert etas[0] == etas[1]


def test_coloured_light_answers_for_other_coefficients(bench):
    """As a graded crystal does; and the mean over colours is that of their weights."""
    records = record(bench("colours", GEL), seed=4)
    k, weighted = records.k, records.further["scattering_path_cm"]
    direct = bench("colours", {"alpha_scat_per_cm": 0.3} | GEL).collect(400_000, seed=5)
    assert_eta(records, (0.3 / 0.54) ** k * np.exp(0.24 * weighted), direct)
    plain = record(bench("", GEL), seed=6)
    parts, factors = scattering_of_colours(4.0, 540.0, 150.0)
    weight = sum(
        part * f ** plain.k.astype(float) * np.exp(0.54 * (1.0 - f) * plain.path_cm)
        for part, f in zip(parts, factors, strict=True)
    )
    assert_eta(plain, weight, bench("colours", GEL).collect(400_000, seed=7))


def test_stock_media_scatter_as_ours_do(bench):
    ours = bench("hg", GEL).collect(500_000, seed=7)
    stock = (
        '<medium type="bulk" id="crystal">\n'
        '    <float name="alpha_scat_per_cm" value="$alpha_scat_per_cm"/>\n    ' + _CRYSTAL
    )
    homogeneous = (
        '<medium type="homogeneous" id="crystal"><spectrum name="sigma_t" value="0.0579"/>'
        '<spectrum name="albedo" value="0.932642487"/>'
    )
    theirs = bench(
        "",
        GEL,
        [
            (stock, homogeneous + HG.format(0.6)),
            ('<default name="alpha_scat_per_cm" value="0.54"/>', ""),
            ('<default name="alpha_abs_per_cm" value="0.039"/>', ""),
        ],
    )
    assert_same_light(ours, theirs.collect(500_000, seed=7), z_max=Z)
    with pytest.raises(InputError, match="phase functions isotropic, hg and rayleigh"):
        bench(
            "",
            None,
            [
                (
                    _CRYSTAL,
                    _CRYSTAL + '<phase type="tabphase">'
                    '<string name="values" value="1, 2, 3"/></phase>',
                )
            ],
        )


# ---- rough and lossy surfaces -------------------------------------------------------------------


@pytest.mark.parametrize("beckmann", [False, True], ids=["ggx", "beckmann"])
@pytest.mark.parametrize(("cosine", "alpha"), [(1.0, 0.2), (0.4, 0.3), (0.05, 0.5), (-0.2, 0.3)])
def test_facets_are_drawn_as_they_are_seen(cosine, alpha, beckmann):
    """Means over drawn facets, some seen from below, against a quadrature of their slopes."""
    mi = use_variant()
    count, seen_from = 400_000, np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    view, rng = mi.Vector3f(*seen_from.tolist()), lane_generators(count, 8)
    uniforms = [rng.next_float32() for _ in range(5)]
    if beckmann:
        facet, taken = dielectric._visible_of_beckmann(view, mi.Float(alpha), uniforms)
        dr.eval(facet, taken)
        facet = np.array(facet, dtype=float)[:, np.array(taken)]
    else:
        facet = np.array(dielectric._visible_of_ggx(view, alpha, *uniforms[:2]), dtype=float)
    slopes = np.sinh(np.linspace(-9, 9, 1001)) * alpha / 3
    p, q = np.meshgrid(slopes, slopes)
    steep2 = (p**2 + q**2) / alpha**2
    density = np.exp(-steep2) if beckmann else (1 + steep2) ** -2
    density *= np.cosh(np.linspace(-9, 9, 1001)) * np.cosh(np.linspace(-9, 9, 1001))[:, None]
    density *= np.maximum(
        seen_from @ np.array([-p.ravel(), -q.ravel(), np.ones(p.size)]), 0
    ).reshape(p.shape)
    m = np.array([-p, -q, np.ones_like(p)]) / np.sqrt(1 + p**2 + q**2)
    for value in (lambda m: m[0], lambda m: m[0] ** 2, lambda m: m[1] ** 2, lambda m: m[2]):
        expected = np.average(value(m), weights=density)
        ours = value(facet)
        assert abs(ours.mean() - expected) < Z * ours.std() / np.sqrt(ours.size) + 3e-5


#: Roughness, negative of Beckmann's facets, and heights in nm, of faces in equilibrium.
FACES = TABLES["faces"]


@pytest.mark.parametrize("contrast", [(2.01, 1.0), (2.01, 1.46), (1.82, 1.0003), (1.46, 1.0)])
def test_isotropic_light_in_equilibrium_stays_isotropic(contrast):
    """As much goes through from either side, and radiance is n^2 at all angles, of every face.

    400,000 photons from each side. Fluxes agree within 0.3 % and 4 standard errors, radiance in
    20 bins of solid angle within 1 % and 4.5: with 1,500 comparisons a right program fails with
    a probability of 1.5 %.
    """
    count = 400_000
    for polarised in (False, True):
        for alpha, heights_nm in FACES[4 * polarised :: 1 + 5 * polarised]:
            ways = [
                _through_a_face(*pair, alpha, heights_nm, count, polarised)
                for pair in (contrast, contrast[::-1])
            ]
            flux = [n**2 * behind.sum() for n, (_, behind) in zip(contrast, ways, strict=True)]
            sigma = np.hypot(*(1 / np.sqrt(f / n**2) for f, n in zip(flux, contrast, strict=True)))
            assert abs(flux[0] / flux[1] - 1) < 0.003 + 4 * sigma, (alpha, heights_nm, flux)
            for here, there in ((0, 1), (1, 0)):
                squares = [contrast[k] ** 2 for k in (here, there)]
                kept, come = ways[here][0], ways[there][1]
                radiance = kept + come * squares[1] / squares[0]
                sigma = np.sqrt(kept + come * (squares[1] / squares[0]) ** 2)
                off = np.abs(radiance - count / 10) / (0.01 * count / 10 + 4.5 * sigma)
                assert off.max() < 1, (alpha, heights_nm, radiance)


def _through_a_face(n_i, n_t, alpha, heights_nm, count, polarised):
    """Isotropic light that has met a face from above, by tenths of cosine squared: shape (2, 10).

    What is above it, and what is behind.
    """
    mi = use_variant()
    facing, ratio, rng = mi.Vector3f(0, 0, 1), opaque([n_i / n_t]), lane_generators(count, 3)
    point = mi.Point2f(rng.next_float32(), rng.next_float32())
    direction = -mi.warp.square_to_cosine_hemisphere(point)
    haze = opaque([2 * np.pi * heights_nm / 540 * n_i]) if heights_nm else None
    field = None
    if polarised:
        field = dielectric.unpolarised_field(direction, dr.two_pi * rng.next_float32())
    at_all, cosine = dr.full(mi.Bool, True, count), -direction.z
    way = dielectric.split(direction, field, facing, ratio, cosine, rng.next_float32())
    if alpha:
        way = dielectric.walk_facets(
            way,
            at_all,
            direction,
            field,
            facing,
            ratio,
            opaque([alpha]),
            haze,
            rng,
            beckmann=alpha < 0,
        )
    elif heights_nm:
        way = dielectric.scatter_by_haze(way, haze, at_all, field, facing, ratio, cosine, rng)
    dr.eval(way[0].z, way[2])  # together, or each kernel would do it all once more
    height, reflected = np.array(way[0].z), np.array(way[2])
    assert np.all((height > 0) == reflected)
    tenth = np.minimum((10 * height**2).astype(int), 9)
    return np.bincount(tenth + 10 * ~reflected, minlength=20).reshape(2, 10)


@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
def test_roughness_lets_all_light_out_of_a_clear_crystal(bench, general):
    clear = {"alpha_scat_per_cm": 0, "alpha_abs_per_cm": 0, "surface_loss": 0}
    rough = bench("polish", clear | {"roughness_alpha": 0.3})
    result = rough.collect(40_000, seed=9, general=general, max_depth=20_000)
    assert result.budget.get("absorbed_surface", 0) == 0
    assert result.budget["truncated"] == 0 and result.budget["lost"] < 1e-5
    assert sum(result.budget.values()) == pytest.approx(1, abs=1e-6)


def test_a_polish_without_faults_is_the_plain_interface(bench):
    """And an offset makes another index of it, of whatever is filled."""
    plain = bench("", GEL).collect(200_000, seed=10).eta
    perfect = bench("polish", {"roughness_alpha": 0, "surface_loss": 0} | GEL)
    assert perfect.collect(200_000, seed=10).eta == plain
    shifted = bench("index", {"n_gap": 1.41, "gap_index_offset": 0.05})
    assert shifted.collect(200_000, seed=10).eta == pytest.approx(plain, rel=1e-4)
    empty = bench("index", {"n_gap": 1.0, "gap_index_offset": 0.05}).collect(200_000, seed=10)
    assert empty.eta == bench().collect(200_000, seed=10).eta


@pytest.mark.parametrize("polarization", [False, True], ids=["unpolarised", "polarised"])
def test_both_paths_agree_on_rough_lossy_crystals_and_choosy_detectors(bench, polarization):
    numbers = {"polarization": polarization, "detector_reflectance": 0.3, "angular_falloff": 0.8}
    simulation = bench("polish detector", numbers | {"radial_falloff": 0.5} | GEL)
    fast = simulation.collect(600_000, seed=11)
    slow = simulation.collect(200_000, seed=12, general=True)
    assert fast.transport != slow.transport and fast.budget["absorbed_surface"] > 0.02
    assert_same_light(fast, slow, z_max=Z)


GROUND_BOX = """<scene version="3.0.0">
  <integrator type="light_collection"/>
  <medium type="bulk" id="crystal"/><medium type="bulk" id="around"/>
  <emitter type="scintillation"><ref id="crystal"/></emitter>
  <shape type="cube" id="box"><transform name="to_world"><scale value="5"/></transform>
    <bsdf type="polish"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1.5"/>
      <float name="roughness_alpha" value="0.3"/><float name="ground_loss" value="0.2"/></bsdf>
    <ref name="interior" id="crystal"/><ref name="exterior" id="around"/></shape>
  <shape type="cube" id="plate"><transform name="to_world"><scale value="8"/></transform>
    <bsdf type="photodetector"/><ref name="interior" id="around"/></shape></scene>"""


#: A shape far away with a BSDF that is asked what it does, so that others are on that path, too.
FAR_METAL = """<shape type="sphere" id="far"><float name="radius" value="1"/>
  <point name="center" x="30" y="0" z="0"/><bsdf type="conductor"/></shape></scene>"""


@pytest.mark.parametrize("path", ["flat", "general", "asking"])
def test_a_ground_face_takes_its_part_once(tmp_path, path):
    """Matched, it reflects nothing: all light that is born within meets it once, and 80 % go on."""
    text = GROUND_BOX.replace("</scene>", FAR_METAL) if path == "asking" else GROUND_BOX
    (tmp_path / "ground.xml").write_text(text)
    simulation = Simulation(tmp_path / "ground.xml", check=False)
    result = simulation.collect(50_000, seed=50, general=path == "general")
    assert result.eta == pytest.approx(0.8, abs=1e-5)
    assert result.budget["absorbed_surface"] == pytest.approx(0.2, abs=1e-5)


def test_records_of_ground_faces_answer_for_what_they_take(bench):
    """Light meets them many times, and those that it meets weigh: not those that are polished."""
    records = record(bench("ground", GEL | {"ground_loss": 0.0}), ("rough_hits",), seed=51)
    lossy = bench("ground", GEL | {"ground_loss": 0.3})
    hits = records.further["rough_hits"].astype(float)
    assert_eta(records, 0.7**hits, lossy.collect(400_000, seed=52))
    assert hits.max() > 5 and (hits == 0).any()


# ---- the emitter --------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [0.2, 3.0, 1e9])
@pytest.mark.parametrize("side", [False, True], ids=["top", "side"])
def test_births_fall_with_depth(bench, depth, side):
    """Kolmogorov and Smirnov at 1e-4, sampled directly and by rejection."""
    use_variant()
    crystal = bench(
        *(("side", {"side_depth_mm": depth}) if side else ("depth", {"source_depth_mm": depth}))
    ).crystal
    rng = lane_generators(50_000, 13)
    for point in (
        crystal.from_uniforms(*(rng.next_float32() for _ in range(3))),
        crystal.sample(rng, 50_000),
    ):
        dr.eval(point)
        x, y, z = (np.array(c, dtype=float) for c in (point.x + 5, point.y + 5, point.z))
        below, *evenly = (x, y, z) if side else (10 - z, x, y)
        assert 0 <= below.min() and below.max() <= 10
        assert kstest(np.expm1(-below / depth) / np.expm1(-10 / depth), "uniform").pvalue > 1e-4
        for across in evenly:
            assert kstest(across / 10, "uniform").pvalue > 1e-4


# ---- one run's records against another run ------------------------------------------------------


@pytest.fixture
def unmasked(bench):
    """Records of the bench with gel and without a mask's rim, with all columns."""
    columns = (*COLUMNS, "path_gap_cm", "path_window_cm")
    return record(bench("", GEL | NO_MASK), columns, seed=20)


def test_records_of_the_plain_bench_answer_for_effects(bench, unmasked):
    """Ten effects by reweighting one run, each against a run that has it in the scene."""
    more = {name: np.asarray(column, dtype=float) for name, column in unmasked.further.items()}
    masked = more["mask_radius_mm"] <= 14
    radius2 = np.square(more["arrival_radius_mm"] / 14)
    cases = {
        "": (masked, {}),
        "rayleigh": (masked * np.exp(more["log_rayleigh"]), {}),
        "loss": (masked * 0.97 ** more["reflections"], {}),
        "depth": (masked * 5 / -np.expm1(-5) * np.exp(-more["birth_depth_mm"] / 2), {}),
        "side": (masked * 5 / -np.expm1(-5) * np.exp(-more["birth_side_mm"] / 2), {}),
        "gap": (masked * np.exp(-10 * more["path_gap_cm"]), {}),
        "masked_detector": (more["arrival_radius_mm"] <= 7, {"aperture_radius_mm": 7}),
    }
    for seed, (effects, (factor, overrides)) in enumerate(cases.items(), start=21):
        assert_eta(unmasked, factor, bench(effects, GEL | overrides).collect(400_000, seed=seed))
    direct = bench("", GEL | {"aperture_radius_mm": 7}).collect(400_000, seed=30)
    assert_eta(unmasked, more["mask_radius_mm"] <= 7, direct)
    for name, factor in (
        ("angular_falloff", more["arrival_cosine"]),
        ("radial_falloff", np.maximum(1 - radius2, 0)),
    ):
        direct = bench("detector", GEL | {name: 1}).collect(400_000, seed=31)
        assert_eta(unmasked, masked * factor, direct)
        assert direct.budget["absorbed_surface"] > 0.01
    assert np.array_equal(unmasked.further["scattering_path_cm"], unmasked.path_cm)
    assert more["reflector_hits"].max() == more["detector_hits"].max() == 0


def test_hits_answer_for_other_reflectances(bench):
    records = record(
        bench("detector", GEL | {"detector_reflectance": 0.5}), ("detector_hits",), seed=32
    )
    hits = records.further["detector_hits"].astype(float)
    direct = bench("detector", GEL | {"detector_reflectance": 0.2}).collect(400_000, seed=33)
    assert_eta(records, 0.8 / 0.5 * 0.4**hits, direct)
    records = record(bench("top", GEL), ("reflector_hits",), seed=34)
    hits = records.further["reflector_hits"].astype(float)
    direct = bench("top", GEL | {"top_reflectance": 0.6}).collect(400_000, seed=35)
    assert_eta(records, (0.6 / 0.99) ** hits, direct)
    assert hits.max() > 3


def test_what_mirrors_and_masks_send_back_answers_for_other_reflectances(bench):
    narrow = GEL | {"aperture_radius_mm": 4}
    for effect, name, column, low in (
        ("mirror", "detector_specular", "detector_hits", 0.2),
        ("housing", "housing_reflectance", "mask_hits", 0.05),
    ):
        records = record(bench(effect, narrow), (column, "mask_radius_mm"), seed=60)
        hits = records.further[column].astype(float)
        direct = bench(effect, narrow | {name: low}).collect(400_000, seed=44)
        factor = KNOWN[f"{effect}_reflection" if effect == "housing" else name].weight
        assert_eta(records, factor({column: hits}, {name: low}, {}), direct)
        assert 0.01 < hits.mean() and hits.max() > 3


def test_a_mask_off_the_axis_is_cut_out_of_records_there(bench):
    """So is a falloff of the detector; mirrored, the bench is the same."""
    columns = ("mask_radius_mm", "arrival_radius_mm")
    records = record(bench("offset", GEL | {"aperture_radius_mm": 60}), columns, seed=45)
    radius, arrival = (records.further[name].astype(float) for name in columns)
    own = GEL | {"aperture_radius_mm": 7}
    direct = bench("offset", own).collect(400_000, seed=46)
    assert_eta(records, radius <= 7, direct)
    on_axis = bench("", own).collect(400_000, seed=46)
    assert direct.eta < 0.85 * on_axis.eta
    assert_same_light(
        direct, bench("offset", own | {"mask_offset_mm": -3}).collect(400_000, seed=47), z_max=Z
    )
    falling = bench("offset", own | {"radial_falloff": 1}).collect(400_000, seed=48)
    assert_eta(records, (radius <= 7) * np.maximum(1 - (arrival / 14) ** 2, 0), falling)


# ---- the photocathode ---------------------------------------------------------------------------


def test_the_kernels_film_is_that_of_the_closed_form():
    mi = use_variant()
    cosine = np.linspace(1e-3, 1, 2001)
    for wavelength, thickness in ((540.0, 15.5), (420.0, 30.0)):
        film = ThinFilm(cathode_index(wavelength), thickness / wavelength, 1.52)
        reflected, transmitted = surface_physics.FilmTerms.of(film).amplitudes(mi.Float(cosine))
        expected = film.powers(cosine)
        for row in range(2):
            power = np.array(dr.squared_norm(reflected[row]), dtype=float)
            assert power == pytest.approx(expected[0][row], abs=2e-5)
            assert np.array(transmitted[row], dtype=float) == pytest.approx(
                expected[1][row], abs=1e-4
            )


#: A crystal in which light flies straight: its bottom is a photocathode, all other faces are black.
DARK_BOX = """<scene version="3.0.0">
  <integrator type="light_collection"><boolean name="polarization" value="{polarization}"/>
  </integrator>
  <medium type="bulk" id="crystal"/><emitter type="scintillation"><ref id="crystal"/></emitter>
  <bsdf type="twosided" id="black"><bsdf type="diffuse"><spectrum name="reflectance" value="0"/>
    </bsdf></bsdf>
  <bsdf type="photodetector" id="film"><float name="cathode_nm" value="15.5"/>
    <float name="window_index" value="1.52"/>{index}</bsdf>
  {faces}</scene>"""
#: Of a film that is not K-Cs-Sb.
OWN_INDEX = '<float name="cathode_n" value="2.5"/><float name="cathode_k" value="0.3"/>'


@cases("polarization", "general", "index", more=[("false", False, OWN_INDEX)])
def test_straight_light_on_a_photocathode(tmp_path, polarization, general, index):
    turns = [
        "",
        '<rotate y="1" angle="90"/>',
        '<rotate y="1" angle="-90"/>',
        '<rotate x="1" angle="90"/>',
        '<rotate x="1" angle="-90"/>',
        '<rotate x="1" angle="180"/>',
    ]
    faces = [
        f'<shape type="rectangle" id="face{i}"><transform name="to_world"><translate z="1"/>{turn}'
        f'<scale value="5"/></transform><ref id="{"film" if i == 5 else "black"}"/>'
        '<ref name="interior" id="crystal"/></shape>'
        for i, turn in enumerate(turns)
    ]
    path = tmp_path / "dark.xml"
    path.write_text(DARK_BOX.format(polarization=polarization, faces="\n".join(faces), index=index))
    simulation = Simulation(path, check=False)
    found = simulation.collect(400_000, seed=49, general=general)
    film = ThinFilm(2.5 + 0.3j if index else cathode_index(540.0), 15.5 / 540.0, 1.52)
    rng, count = np.random.default_rng(50), 400_000
    start, direction = rng.random((count, 3)) * 10 - 5, rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    length = (np.sign(direction) * 5 - start) / direction
    down = (length.argmin(axis=1) == 2) & (direction[:, 2] < 0)
    cosine = np.abs(direction[:, 2])
    reflected, transmitted = (part.mean(axis=0) for part in film.powers(cosine))
    for value, sigma, expected in (
        (found.eta, found.eta_sigma, down * film.absorptance(cosine) / film.head_on),
        (
            found.budget["absorbed_surface"],
            found.budget_sigma["absorbed_surface"],
            down * transmitted,
        ),
        (
            found.budget["absorbed_reflector"],
            found.budget_sigma["absorbed_reflector"],
            ~down + down * reflected,
        ),
    ):
        error = expected.std() / np.sqrt(count)
        assert_compatible(value, sigma, expected.mean(), error, z_max=Z)
    assert found.eta == found.budget["detected"] / film.head_on
    assert sum(found.budget.values()) == pytest.approx(1, abs=1e-6)
    assert "absorbed_surface" in found.budget and "of light that arrives head-on" in found.notes[0]
    # records carry the same weights
    records = (
        simulation.launcher(general)
        .launch(2**17, seed=51, number=0, max_depth=100, columns=("arrival_cosine",))
        .records
    )
    arrived = records["arrival_cosine"].astype(float)
    reflected, _ = (part.mean(axis=0) for part in film.powers(arrived))
    if polarization == "false":
        expected = film.absorptance(arrived) / (1 - reflected) / film.head_on
        steep = np.abs(arrived - np.sqrt(1 - 1 / 1.52**2)) > 0.01
        assert np.abs(records["w"][steep] / expected[steep] - 1).max() < 0.01


@pytest.mark.parametrize("polarization", [False, True], ids=["unpolarised", "polarised"])
def test_both_paths_agree_on_films_mirrors_and_grey_masks(bench, polarization):
    for effects in ("film housing", "mirror housing offset"):
        own = GEL | {"polarization": polarization, "aperture_radius_mm": 5}
        simulation = bench(effects, own)
        fast = simulation.collect(400_000, seed=52)
        slow = simulation.collect(150_000, seed=53, general=True)
        assert fast.transport != slow.transport
        assert_same_light(fast, slow, z_max=Z)


def test_slanted_light_may_count_more_than_once(bench):
    records = record(bench("", GEL), ("arrival_cosine",), seed=54)
    cosine = records.further["arrival_cosine"].astype(float)
    direct = bench("detector", GEL | {"angular_falloff": -1}).collect(400_000, seed=55)
    assert_eta(records, 2 - cosine, direct)
    assert direct.eta == 2 * direct.budget["detected"]
    assert sum(direct.budget.values()) == pytest.approx(1, abs=1e-6)


def test_trails_end_where_the_light_does(bench):
    """Followed photon by photon a film detects whole photons, so many of those that arrive."""
    simulation = bench("film", GEL)
    own = simulation.collect(400_000, seed=56)
    launcher, trails = simulation.launcher(fold=False), TrailStore(LANES, 8)
    found = launcher.launch(LANES, seed=57, number=0, max_depth=10_000, trails=trails)
    share = found.weights["detected"].sum() / LANES
    expected = own.budget["detected"]
    assert abs(share - expected) < Z * np.sqrt(expected / LANES)
    assert found.weights["detected"].sum() == int(found.weights["detected"].sum())


def test_a_masked_detector_on_either_path(bench):
    simulation = bench("masked_detector", GEL | {"aperture_radius_mm": 7})
    fast, slow = (simulation.collect(200_000, seed=36 + g, general=bool(g)) for g in (0, 1))
    assert_same_light(fast, slow, z_max=Z)
    assert fast.budget["absorbed_aperture"] > 0.05


def test_a_gap_of_air_does_not_absorb(bench):
    for n_gap, expected in ((1.0, 0.0), (1.46, 1.0)):
        model = bench("gap", {"n_gap": n_gap}).model
        gap = model.volumes[model.volume_names.index("gap")]
        assert gap.alpha_abs_per_mm == expected


# ---- records and random numbers -----------------------------------------------------------------


def test_records_hold_what_is_asked_for(bench, tmp_path):
    simulation = bench()
    assert record(simulation, seed=40, launches=1).further == {}
    wanted = ("arrival_cosine", "detector_hits", "path_gap_cm", "detector_hits", "log_rayleigh")
    further = record(simulation, wanted, seed=40, launches=1).further
    kinds = {name: column.dtype for name, column in further.items()}
    assert kinds == {
        "arrival_cosine": np.float16,
        "detector_hits": np.uint8,
        "path_gap_cm": np.float16,
        "log_rayleigh": np.float32,
    }
    with pytest.raises(InputError, match="no column 'path_crystal_cm'"):
        record(simulation, ("path_crystal_cm",), seed=40, launches=1)
    # counts stay at the largest number of their kind
    box = boxed(tmp_path).file.path
    box.write_text(
        BOX.format(phase="").replace(
            '<bsdf type="photodetector"/>',
            '<bsdf type="photodetector"><float name="reflectance" value="0.995"/></bsdf>',
        )
    )
    hits = record(
        Simulation(box, check=False), ("detector_hits",), seed=41, launches=1, alpha_abs=0
    ).further["detector_hits"]
    # of photons that leave with probability 0.005, 0.995^255 are sent back 255 times or more
    assert np.mean(hits == 255) == pytest.approx(0.995**255, abs=0.02)


def test_photons_that_do_the_same_have_the_same_numbers(bench):
    """Photons of two nearly equal benches go the same ways: differences are known far better."""

    def etas(n_gap):
        simulation = bench("", {"n_gap": n_gap})
        found = transport.launch(
            collection.choose_path(simulation.model, False),
            simulation.crystal,
            plan_lanes(32 * LANES),
            seed=42,
            number=0,
            max_depth=200_000,
        )
        return found.weights["detected"] / found.photons_per_batch

    one, other, air = etas(1.46), etas(1.461), etas(1.0)

    def spread(other):
        return np.std(one - other) / np.hypot(np.std(one), np.std(other))

    # measured 0.040 and 0.59; 0.13 and 0.9 where a lane's numbers simply run on
    assert spread(other) < 0.055 and spread(air) < 0.7


def test_half_an_index_of_a_photocathode_is_refused(tmp_path):
    path, half = tmp_path / "dark.xml", '<float name="cathode_n" value="2.5"/>'
    path.write_text(DARK_BOX.format(polarization="false", faces="", index=half))
    with pytest.raises(InputError, match="one index; give both"):
        Simulation(path, check=False)


@cases("effects", "name", "value", "message")
def test_impossible_values_are_refused(bench, effects, name, value, message):
    with pytest.raises(InputError, match=message):
        bench(effects, {name: value})
