"""Comments of constants (``#:``) stay as they are written.

Napoleon takes the words before a colon in them for a type.
"""

_CONSTANTS = ("attribute", "data")


def setup(app) -> dict[str, bool]:
    comments: dict[str, list[str]] = {}

    def keep(app, what, name, obj, options, lines) -> None:
        if what in _CONSTANTS:
            comments[name] = list(lines)

    def give_back(app, what, name, obj, options, lines) -> None:
        if name in comments:
            lines[:] = comments.pop(name)

    # before Napoleon, which has 500, and after it
    app.connect("autodoc-process-docstring", keep, priority=100)
    app.connect("autodoc-process-docstring", give_back, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
