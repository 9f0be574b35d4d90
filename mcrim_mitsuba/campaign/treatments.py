"""What was done to the crystal from reading to reading: effects that rows switch on and off.

A column of the measurements that is named after an effect says with 0 and 1 which rows have it. An
effect that the campaign switches on besides is put into the scene at the size that its fit begins
with, so that all else is simulated beside it, and rows without it have the value that takes it out.
Its size is shared by its rows, and by other effects where a tie says so. A column may switch a
part of the scene too: a wrapping, by its id, or one of its faces; or a sheet in air, such as black
paper or a mirror, which is clear as air in rows that are without it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.core.errors import did_you_mean, said_by
from mcrim_mitsuba.core.numbers import COEFFICIENTS, Value
from mcrim_mitsuba.core.toml_document import TomlDocument
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.effects.scene_edits import set_part
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign

_PARAMETERS = "parameters"
#: What a sheet wears that is not there: an interface of air and air.
_CLEAR = (
    '<bsdf type="dielectric" id="{}">\n  <float name="int_ior" value="1"/>\n'
    '  <float name="ext_ior" value="1"/>\n</bsdf>\n'
)


def switchable(
    effects: Mapping[str, Effect], scene: SceneFile, document: TomlDocument
) -> list[str]:
    """What a column may switch, parts and effects: not what is a number that rows may give."""
    fitted = {*document.table(_PARAMETERS), *map(str, document.content.get("effects", []))}
    names = [*_parts_of(scene), *_sheets_of(scene), *effects]
    return [name for name in names if name not in scene.parameters or name in fitted]


def _parts_of(scene: SceneFile) -> dict[str, tuple[str, str]]:
    """Wrappings by their ids, and faces of a single one: which it is, and what it then lacks."""
    wrappings = {node.get("id", ""): node for node in scene.parts.all("shape", "wrapping")}
    parts = {name: (name, "top sides") for name in wrappings if name}
    if len(wrappings) == 1:
        ((name, wrapping),) = wrappings.items()
        four = wrapping.named("diameter") is None and wrapping.named("sides") is None
        faces = ("top", "sides", *(("right", "left", "back", "front") if four else ()))
        parts |= {face: (name, face) for face in faces}
    return parts


def _sheets_of(scene: SceneFile) -> list[str]:
    """Ids of surfaces that stand in air, and of which something can be left out."""
    parts = scene.parts
    sheets = [shape for shape in parts.shapes if parts.media(shape) == (None, None)]
    return [
        sheet.get("id", "")
        for sheet in sheets
        if sheet.get("id") and sheet.type != "wrapping" and parts.bsdf(sheet) is not None
        if all(bsdf.type != "photodetector" for bsdf in parts.worn_by(sheet))
    ]


def states(campaign: Campaign, without: Collection[str]) -> list[str]:
    """What some rows have and others not, as it is `without` some of it, in words."""
    rows, parts = campaign.measurements.readings, _parts_of(campaign.scene)
    words, lone = [], len({wrapping for wrapping, _ in parts.values()}) == 1
    for name in campaign.measurements.switches:
        off = name in without
        if not off and not any(name in row.without for row in rows):
            continue
        if name in parts and lone:
            of = "" if parts[name][0] == name else f"{name} "
            words.append(f"{of}{'bare' if off else 'wrapped'}")
        else:
            effect = campaign.catalogue.get(name)
            words.append(f"{'without' if off else 'with'} {effect.title if effect else name}")
    return words


def with_treatments(campaign: Campaign, document: TomlDocument) -> Campaign:
    """The campaign with the effects in its scene that rows switch, or that share their sizes.

    Raises InputError where a tie cannot be, where no row has an effect, and where an effect that
    shares its size cannot be taken out of a scene.
    """
    switches, readings = campaign.measurements.switches, campaign.measurements.readings
    for name in switches:
        if all(name in reading.without for reading in readings):
            problem = f"{name} is switched on in no row"
            mend = "write 1 into the rows that have it, or remove the column"
            raise campaign.measurements.refusal(readings[0], name, problem, mend)
    campaign = _with_clear_sheets(_with_bare_faces(campaign))
    ties = _read_ties(document, campaign)
    if not ties and not switches:
        return campaign
    tied = {*ties, *ties.values()}
    sizes_of = {effect.name: effect.switched_off or {} for effect in campaign.switched_on}
    treatments = tuple(n for n, of in sizes_of.items() if of and (n in switches or tied & {*of}))
    scene = campaign.scene
    for name in treatments:
        effect = campaign.catalogue[name]
        if not effect.is_in(scene):
            with said_by(partial(document.refusal, "effects"), placed_too=False):
                scene = scene.edited(add(effect, scene))
    editor = SceneEditor(scene, {})
    sizes = [size for name in treatments for size in sizes_of[name]]
    for size in sizes:
        start = document.table(f"{_PARAMETERS}.{ties.get(size, size)}").number("start")
        if start is not None:
            editor.set_default(size, start)
    scene = scene.edited(editor.finished()) if sizes else scene
    effects = tuple(name for name in campaign.effects if name not in treatments)
    campaign = replace(campaign, scene=scene, effects=effects, treatments=treatments, ties=ties)
    off = {without: taken_off(campaign, without) for without in {row.without for row in readings}}
    rows = tuple(replace(r, parameters={**r.parameters, **off[r.without]}) for r in readings)
    return replace(campaign, measurements=replace(campaign.measurements, readings=rows))


def as_in_scene(
    campaign: Campaign, cells: Mapping[str, Value]
) -> tuple[dict[str, Value], tuple[str, ...]]:
    """Scene parameters of a configuration given by cells of columns, and what is off in it."""
    switches = campaign.measurements.switches
    off = tuple(name for name in switches if not cells.get(name, True))
    by_hand = {name: value for name, value in cells.items() if name not in switches}
    return by_hand | taken_off(campaign, off), off


def taken_off(campaign: Campaign, without: Collection[str]) -> dict[str, Value]:
    """Parameters of the campaign's scene that take out of it what its columns switch."""
    scene, parts, values = campaign.scene, _parts_of(campaign.scene), dict[str, Value]()
    wrapped = _bare_faces(SceneEditor(scene, {})) if parts.keys() & {*without} else {}
    for name in without:
        if name in parts:
            wrapping, faces = parts[name]
            parameter, usual = wrapped[wrapping]
            bare = f"{values.get(parameter, usual)} {faces}".replace(",", " ").split()
            values[parameter] = " ".join(face for face in dict.fromkeys(bare) if face != "none")
        elif f"{name}_surface" in scene.parameters:
            values[f"{name}_surface"] = f"{name}_clear"
        elif name in campaign.catalogue and campaign.catalogue[name].is_in(scene):
            values |= campaign.catalogue[name].switched_off or {}
    return values


def _bare_faces(editor: SceneEditor) -> dict[str, tuple[str, str]]:
    """The parameter that says which faces a wrapping leaves bare, and its usual value, by id."""
    faces = {}
    for wrapping in editor.all("shape", "wrapping"):
        name, part = wrapping.get("id", ""), wrapping.named("without")
        given = "" if part is None else part.get("value", "")
        usual = f"{name or 'wrapping'}_without"
        parameter = given.removeprefix("$") if given.startswith("$") else usual
        faces[name] = parameter, str(editor.scene.parameters.get(parameter, given or "none"))
    return faces


def _with_bare_faces(campaign: Campaign) -> Campaign:
    """The campaign with the faces that its rows leave bare as a parameter of each wrapping."""
    parts = _parts_of(campaign.scene)
    switched = {parts[name][0] for name in campaign.measurements.switches if name in parts}
    if not switched:
        return campaign
    editor = SceneEditor(campaign.scene, {})
    wrapped = _bare_faces(editor)
    for wrapping in editor.all("shape", "wrapping"):
        name, part = wrapping.get("id", ""), wrapping.named("without")
        parameter, usual = wrapped[name]
        if name not in switched or (part is not None and part.get("value") == f"${parameter}"):
            continue
        editor.declare(parameter, usual, f"Faces that {name or 'the wrapping'} leaves bare")
        if part is None:
            xml = f'<string name="without" value="${parameter}"/>'
            set_part(editor, [wrapping], "without", xml)
        else:
            editor.set_attribute(part, "value", f"${parameter}")
    return replace(campaign, scene=campaign.scene.edited(editor.finished()))


def _with_clear_sheets(campaign: Campaign) -> Campaign:
    """The campaign with what its sheets wear as parameters, which rows without them change."""
    sheets = [n for n in campaign.measurements.switches if n in _sheets_of(campaign.scene)]
    if not sheets:
        return campaign
    editor = SceneEditor(campaign.scene, {})
    for shape in editor.shapes:
        if (name := shape.get("id", "")) not in sheets:
            continue
        worn = next(e for e in shape.elements if getattr(editor.target(e), "tag", "") == "bsdf")
        there, before = worn.get("id", f"{name}_there"), _CLEAR.format(f"{name}_clear")
        if worn.tag == "bsdf":
            text = editor.source(worn)
            before += text if worn.get("id") else text.replace("<bsdf", f'<bsdf id="{there}"', 1)
        editor.insert_after(editor.root.elements[editor.root.elements.index(shape) - 1], before)
        editor.replace(worn, f'<ref id="${name}_surface"/>')
        editor.declare(f"{name}_surface", there, f"What {name} wears: {name}_clear takes it off")
    return replace(campaign, scene=campaign.scene.edited(editor.finished()))


def _read_ties(document: TomlDocument, campaign: Campaign) -> dict[str, str]:
    """``same_as`` of the parameters, by name."""
    sizes = [size for effect in campaign.switched_on for size in effect.switched_off or ()]
    numbers = [n for n, value in campaign.scene.parameters.items() if isinstance(value, float)]
    can = [n for n in dict.fromkeys([*sizes, *numbers]) if n not in COEFFICIENTS]
    ties: dict[str, str] = {}
    for name in document.table(_PARAMETERS):
        table = document.table(f"{_PARAMETERS}.{name}")
        if schema.SAME_AS not in table:
            continue
        leader = table[schema.SAME_AS]
        if others := [entry for entry in table if entry != schema.SAME_AS]:
            problem = f"{name} has {schema.SAME_AS} and {others[0]}"
            raise table.refusal(others[0], problem, f"write {others[0]} at {leader}, or remove it")
        for which in (name, leader):
            if which not in can:
                problem = f"{which} is neither a number of the scene nor a size of an effect in it"
                mend = did_you_mean(str(which), can)
                raise table.refusal(schema.SAME_AS, f"{problem} or in effects", mend)
        if leader == name or schema.SAME_AS in document.table(f"{_PARAMETERS}.{leader}"):
            problem = f"{name} is to be the same as {leader}, which has no value of its own"
            raise table.refusal(schema.SAME_AS, problem, "name the one that is fitted")
        if leader not in sizes and leader not in document.table(_PARAMETERS):
            problem = f"{leader} is not fitted: nothing moves {name}"
            raise table.refusal(schema.SAME_AS, problem, f"add [{_PARAMETERS}.{leader}]")
        for column in {name, leader} & {*campaign.measurements.columns}:
            problem = f"{column} is a column of {campaign.measurements.path.name}, and tied"
            raise table.refusal(schema.SAME_AS, problem, "remove the column, or the tie")
        ties[name] = leader
    return ties
