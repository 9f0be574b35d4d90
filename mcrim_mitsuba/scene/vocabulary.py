"""The words of a Mitsuba scene: elements, their attributes and the plugins that a bench is made of.

As the parser of Mitsuba 3.9.1 has them. It refuses others too, but says nothing of what was
meant, and only after what is missing for a misspelt word has been found missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.errors import did_you_mean

if TYPE_CHECKING:
    from lxml import etree

_PLUGINS = "bsdf emitter film integrator medium phase rfilter sampler sensor shape texture volume"
_AXES = "value x y z"
#: Attributes that an element must have, and those that it may have.
_ATTRIBUTES = {
    **dict.fromkeys(_PLUGINS.split(), ("type", "id name")),
    **dict.fromkeys(("boolean", "float", "integer", "rgb", "string"), ("name value", "")),
    **dict.fromkeys(("point", "vector"), ("name", _AXES)),
    **dict.fromkeys(("scale", "translate"), ("", _AXES)),
    "alias": ("id as", ""),
    "default": ("name value", ""),
    "include": ("filename", "name"),
    "lookat": ("origin target", "up"),
    "matrix": ("value", ""),
    "path": ("value", ""),
    "ref": ("id", "name"),
    "rotate": ("angle", _AXES),
    "spectrum": ("name", "value filename"),
    "transform": ("name", ""),
}
#: Types of plugins, this package's first, by element; those that a bench can be made of.
PLUGIN_TYPES = {
    kind: names.split()
    for kind, names in {
        "bsdf": "aperture photodetector polish conductor dielectric diffuse mask null plastic "
        "roughconductor roughdielectric thindielectric twosided",
        "emitter": "scintillation collimated_beam",
        "integrator": "light_collection",
        "medium": "bulk homogeneous heterogeneous",
        "phase": "hg isotropic rayleigh",
        "sensor": "light_meter",
        "shape": "beam_detector chamfers frame gap_sides lying_fillet lying_mantle panel polygon "
        "prism_sides round_wall wrapping cube cylinder disk obj ply rectangle sphere",
    }.items()
}
#: Of a face: where its normal comes from, and where it points to.
SIDES = ("interior", "exterior")


def misspelt(element: etree._Element) -> tuple[str, str] | None:
    """What is wrong with the words of one element, and how to mend it; None if nothing is."""
    tag = str(element.tag)
    if tag not in _ATTRIBUTES:
        return f"<{tag}> is no element of a scene", did_you_mean(tag, sorted(_ATTRIBUTES))
    needed, possible = (names.split() for names in _ATTRIBUTES[tag])
    for name in element.attrib:
        if name not in (*needed, *possible):
            problem = f"<{tag}> has no attribute {name}"
            return problem, did_you_mean(str(name), [*needed, *possible])
    for name in needed:
        if name not in element.attrib:
            return f"this <{tag}> has no {name}", f'write <{tag} {name}="...">'
    return None


def misled(root: etree._Element) -> Iterator[tuple[etree._Element, str, str]]:
    """Every ``<ref>`` to nothing, or to a volume on no side; what is wrong, how to mend it."""
    ids = {e.get("id"): str(e.tag) for e in root.iter() if e.tag not in ("ref", "alias")}
    names = {*ids, *(e.get("as") for e in root.iter("alias"))}
    of_shapes = set(root.iterfind("shape/ref"))
    for element in root.iter("ref"):
        if (name := element.get("id", "")) not in names:
            # what carries light's surfaces and volumes, not the shapes that wear them
            meant = [id_ for id_, tag in ids.items() if id_ and tag != "shape"]
            yield element, f"{name!r} is the id of nothing in this scene", did_you_mean(name, meant)
        elif ids.get(name) == "medium" and element in of_shapes:
            if (side := element.get("name", "")) not in SIDES:
                problem = f"the volume {name!r} is on no side of this shape: name={side!r}"
                yield element, problem, did_you_mean(side, SIDES)
