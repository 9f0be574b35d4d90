"""What a scene file names: shapes, BSDFs, media, emitter and integrator.

Each module registers its plugins with the active variant of Mitsuba when it is (re)loaded."""

from __future__ import annotations

import re
import sys
from inspect import cleandoc

#: Properties of Mitsuba's plugins that benches are made of, by type.
_MITSUBAS = {
    **dict.fromkeys(("dielectric", "thindielectric"), "int_ior ext_ior"),
    "roughdielectric": "int_ior ext_ior alpha distribution",
    "diffuse": "reflectance",
    "homogeneous": "albedo sigma_t scale",
    "hg": "g",
    **dict.fromkeys(("cube", "disk", "rectangle"), "to_world flip_normals"),
    "cylinder": "p0 p1 radius to_world flip_normals",
    "sphere": "center radius to_world flip_normals",
}
_TYPE = re.compile(r'XML:\s+``<\w+ type="(\w+)"')
_PROPERTIES = re.compile(r"^(``.+``) : ", re.MULTILINE)


def properties_of_plugins() -> dict[str, list[str]]:
    """Names of properties by type of plugin; of this package's the loaded classes tell them."""
    properties = {name: names.split() for name, names in _MITSUBAS.items()}
    loaded = [m for name, m in sys.modules.items() if name.startswith(f"{__name__}.")]
    for text in (cleandoc(c.__doc__ or "") for module in loaded for c in vars(module).values()):
        if told := _TYPE.search(text):
            properties[told[1]] = re.findall(r"``(\w+)``", " ".join(_PROPERTIES.findall(text)))
    return properties


def number(props, name: str, default: float, low: float = 0.0, high: float = 1.0) -> float:
    """A number of a plugin's; raises ValueError where it is out of range."""
    value = float(props.get(name, default))
    if not low <= value <= high:
        raise ValueError(f"{name} is {value:g}; give {low:g} to {high:g}")
    return value


def sizes(props, *names: str) -> list[float]:
    """Lengths of a plugin's; raises ValueError for one that is not above 0."""
    lengths = [float(props[name]) for name in names]
    for name, length in zip(names, lengths, strict=True):
        if not length > 0.0:
            raise ValueError(f"{name} is {length:g}; give a positive number")
    return lengths


#: What ``axis`` of a beam, and of its detector, may be.
BEAM_AXES = ("x", "y", "z")


def beam_axis(props) -> str:
    """The ``axis`` of a beam's plugin, ``x`` when absent; raises ValueError for another one."""
    axis = str(props.get("axis", BEAM_AXES[0]))
    if axis not in BEAM_AXES:
        raise ValueError(f"axis is {axis!r}; give {', '.join(BEAM_AXES[:-1])} or {BEAM_AXES[-1]}")
    return axis


def described(names: str):
    """The methods `traverse` and `to_string` of a plugin that consists of attributes, ``"a b"``.

    (A plugin has one base class, Mitsuba's, so that they cannot be inherited.)
    """

    def traverse(self, callback) -> None:
        import mitsuba as mi

        for name in names.split():
            if getattr(self, name) is not None:
                callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        numbers = ", ".join(f"{name} = {getattr(self, name)}" for name in names.split())
        return f"{type(self).__name__}[{numbers}]"

    return traverse, to_string
