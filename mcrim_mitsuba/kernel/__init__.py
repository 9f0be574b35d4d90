"""The only subpackage that imports Mitsuba and Dr.Jit: plugins, transport, scenes."""
