"""Is a scene sound, and what does it mean? Finds what Mitsuba does not."""

from mcrim_mitsuba.check.scene import check_scene

__all__ = ["check_scene"]
