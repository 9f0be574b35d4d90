"""Meshes that a scene names: what their files hold, and what nothing can be made of.

Mitsuba takes an index of -1 for 0, and looks up those beyond the last vertex wherever that leads.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import look_around, read_bytes
from mcrim_mitsuba.scene.scene_file import LARGEST_NAMED_FILE_MB, SceneFile

#: Vertices, (n, 3), in units of the file; numbers of the corners of triangles, (m, 3), from 0.
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
EXPORT_AGAIN = "export the mesh again, as a PLY or OBJ of triangles"
_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2"}
_TYPES |= {"uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
#: Of a PLY's header: an element with its properties; a property, a list or not.
_ELEMENT = r"\nelement (\w+) (\d+)((?:\s*\n(?:property|comment|obj_info) .*)*)"
_PROPERTY = r"\nproperty (?:list (\w+) )?(\w+) (\w+)"


def refuse_broken_meshes(file: SceneFile) -> None:
    """Refuse a mesh of a scene that is not there, or that Mitsuba would misread or not survive.

    What cannot be read here, in a form that is not known, is left for Mitsuba to judge.
    """
    for element, paths in file.naming():
        shape = element.getparent()
        if shape is None or shape.tag != "shape" or shape.get("type") not in _READERS:
            continue
        if not paths:
            name, (path, line) = element.get("value", ""), file.place_of(element)
            mend = look_around(file.path.parent / name, "name it as seen from the scene's folder")
            raise InputError(f"there is no mesh file {name}", mend, path=path, line=line)
        status = paths[0].stat()
        _judge(paths[0], shape.get("type", ""), status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=256)
def _judge(path: Path, kind: str, _size: int, _time_ns: int) -> None:
    """Refuse a mesh file; one that was sound is not read again."""
    try:
        read_mesh(path, kind)
    except InputError:
        raise
    except (ValueError, LookupError):
        pass


def read_mesh(path: Path, kind: str) -> Mesh:
    """Vertices and triangles of a file of this `kind`, ``ply`` (ASCII or binary) or ``obj``.

    Raises InputError where no shape can be made of them, ValueError or LookupError where their form
    is not known.
    """
    data = read_bytes(path, LARGEST_NAMED_FILE_MB)
    with placed(path=path):
        if kind == "ply" and not data.startswith(b"ply"):
            raise InputError("this is no PLY file: it does not begin with ply", EXPORT_AGAIN)
        if kind == "obj" and data.startswith(b"ply"):
            raise InputError("this is a PLY file, not OBJ", 'write type="ply"')
        vertices, triangles = _READERS[kind](data)
        if not len(triangles):
            raise InputError("the mesh has no triangles", EXPORT_AGAIN)
        if len(wrong := triangles[(triangles < 0) | (triangles >= len(vertices))]):
            first = int(kind == "obj")
            numbers = f"vertices are {first} to {len(vertices) - 1 + first}"
            problem = f"a corner of a triangle is vertex {wrong[0] + first}, but the {numbers}"
            raise InputError(problem, EXPORT_AGAIN)
        if not np.isfinite(vertices).all():
            raise InputError("a vertex of the mesh is not finite", EXPORT_AGAIN)
    return vertices, triangles


def _obj(data: bytes) -> Mesh:
    """Polygons are cut into triangles, as Mitsuba cuts them."""
    lines = [line.split() for line in data.decode("latin-1").splitlines()]
    vertices = np.array([line[1:4] for line in lines if line[:1] == ["v"]], float)
    facets = [[int(n.split("/")[0]) for n in line[1:]] for line in lines if line[:1] == ["f"]]
    fans = [(f[0], *pair) for f in facets for pair in itertools.pairwise(f[1:])]
    return vertices.reshape(-1, 3), np.array(fans, int).reshape(-1, 3) - 1


def _ply(data: bytes) -> Mesh:
    """Whatever stands beside coordinates and triangles is passed over."""
    head, body = re.split(rb"\nend_header[ \t]*\r?\n", data, maxsplit=1)
    text = head.decode("latin-1")
    (form,) = re.findall(r"\nformat (\w+)", text)
    if form == "ascii":  # the numbers of a text as if all were of one type
        body = np.array(body.split(), float).tobytes()
    types = dict.fromkeys(_TYPES, "f8") if form == "ascii" else _TYPES
    order = ">" if form == "binary_big_endian" else "<"
    tables, offset = dict[str, np.ndarray](), 0
    for element, count, properties in re.findall(_ELEMENT, text):
        fields: list[tuple] = []
        for length, number, name in re.findall(_PROPERTY, properties):
            if length:
                fields.append(("corners", order + types[length]))
            fields.append((name, order + types[number], *([3] if length else [])))
        table = np.frombuffer(body, np.dtype(fields), int(count), offset)
        tables[element], offset = table, offset + table.nbytes
        is_listed = element == "face" and "corners" in (table.dtype.names or ())
        if is_listed and (table["corners"] != 3).any():
            raise InputError("the mesh has faces that are no triangles", "triangulate it")
    vertices = np.column_stack([tables["vertex"][axis] for axis in "xyz"]).astype(float)
    faces = tables.get("face", np.zeros(0, [("vertex_index", int, 3)]))
    (name,) = (name for name in faces.dtype.names or () if name.startswith("vertex_ind"))
    return vertices, faces[name].astype(np.int64)


_READERS: dict[str, Callable[[bytes], Mesh]] = {"obj": _obj, "ply": _ply}
