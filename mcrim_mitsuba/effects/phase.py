"""Gives the crystal of a scene a phase function."""

from __future__ import annotations

from mcrim_mitsuba.files.scene_editor import SceneEditor


def set_phase(editor: SceneEditor, xml: str) -> None:
    """Put ``<phase>`` into the crystal's medium, or refuse one that has its own."""
    for part in editor.crystal.elements:
        if part.tag == "phase":
            raise editor.refusal(
                f"the crystal has the phase function {part.type} already",
                "there can be only one: remove it first", part,
            )  # fmt: skip
    editor.insert_last(editor.crystal, xml)
