"""Writes a page for every package of ours, with all its public modules, for autodoc to fill in.

(``sphinx.ext.apidoc`` does the same, but lists re-exported names twice and cannot be told not to.)
"""

import pkgutil
from importlib.util import find_spec
from pathlib import Path

PACKAGE = "mcrim_mitsuba"
FOLDER = "api"

_OPTIONS = ("members", "ignore-module-all")


def titled(title: str, underline: str) -> str:
    return f"{title}\n{underline * len(title)}\n\n"


def short(name: str) -> str:
    """A module's name without what all of them have in common."""
    return name.removeprefix(f"{PACKAGE}.")


def automodule(name: str) -> str:
    options = "".join(f"   :{each}:\n" for each in _OPTIONS)
    return f".. automodule:: {name}\n{options}\n"


def pages(package: str, folder: Path) -> dict[str, str]:
    """Text of the pages of a package and of those in it, by name."""
    found = [each for each in pkgutil.iter_modules([str(folder)]) if each.name[0] != "_"]
    packages = [each.name for each in found if each.ispkg]
    name = "Python reference" if package == PACKAGE else short(package)
    text = titled(name, "=") + automodule(package)
    if packages:
        text += ".. toctree::\n   :maxdepth: 1\n\n"
        text += "".join(f"   {package}.{each}\n" for each in packages) + "\n"
    modules = [f"{package}.{each.name}" for each in found if not each.ispkg]
    for module in modules:
        text += titled(short(module), "-") + automodule(module)
    made = {package: text}
    for each in packages:
        made |= pages(f"{package}.{each}", folder / each)
    return made


def write(app) -> None:
    folder = Path(app.srcdir, FOLDER)
    folder.mkdir(exist_ok=True)
    (home,) = find_spec(PACKAGE).submodule_search_locations
    made = {folder / f"{name}.rst": text for name, text in pages(PACKAGE, Path(home)).items()}
    for path in folder.glob("*.rst"):
        if path not in made:
            path.unlink()
    for path, text in made.items():
        # what did not change need not be built again
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app) -> dict[str, bool]:
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
