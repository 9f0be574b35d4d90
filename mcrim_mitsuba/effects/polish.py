"""Turns plain interfaces of a scene into those that know about real polish."""

from __future__ import annotations

from mcrim_mitsuba.files.scene_editor import Node, SceneEditor

_INDICES = ("int_ior", "ext_ior")
_FURTHER = ("int_offset", "ext_offset", "roughness_alpha", "surface_loss")


def polish(editor: SceneEditor, bsdf: Node, name: str, value: str) -> None:
    """Make a ``dielectric`` a ``polish`` and give it one more number.

    Parameters
    ----------
    editor : SceneEditor
    bsdf : Node
        A ``dielectric``, or a ``polish`` already.
    name, value : str
        Of the number.

    Raises
    ------
    InputError
        If it holds something that the plugin ``polish`` does not know.
    """
    for index in _INDICES:
        if bsdf.child("float", name=index) is None:
            raise editor.refusal(
                f"{bsdf.label} gives no number for {index}",
                f'write <float name="{index}" value="..."/>', bsdf,
            )  # fmt: skip
    for part in bsdf.elements:
        if part.attributes.get("name") not in _INDICES + _FURTHER:
            raise editor.refusal(
                f"{bsdf.label} has {part.attributes.get('name', part.tag)}, which an interface "
                "with real polish has not", "remove it", part,
            )  # fmt: skip
    if bsdf.type == "dielectric":
        editor.set_attribute(bsdf, "type", "polish")
    editor.insert_last(bsdf, f'<float name="{name}" value="{value}"/>')
