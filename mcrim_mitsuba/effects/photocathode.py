"""Gives the detectors of a scene one more number."""

from __future__ import annotations

from mcrim_mitsuba.files.scene_editor import SceneEditor


def set_detector(editor: SceneEditor, name: str, value: str) -> None:
    """Put ``<float>`` into every ``photodetector``, or refuse one that has it."""
    for detector in editor.detectors:
        known = detector.named(name)
        if known is not None:
            raise editor.refusal(
                f"the detector has its {name} already", "change this number instead", known
            )
        editor.insert_last(detector, f'<float name="{name}" value="{value}"/>')
