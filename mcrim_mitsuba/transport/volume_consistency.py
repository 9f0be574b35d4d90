"""Keeps the books of volumes entered and left along straight lines through a scene.

Coming from outside, a line is in a volume that the last face named, with the index
that this face gave; the next face must say the same of its near side. Where they disagree,
hypotheses are tried: one face is reversed; volumes overlap; a volume is not closed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.scene.check_text import Interface, SceneProblem
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.scene_model import SceneModel, Surface


#: Lines that pass closer than this (relative to the scene's size) to a face's rim are left out:
#: there rounding of single precision positions decides which of two faces is met.
RIM = 1e-6
#: Crossings followed along one line of a scene with curved faces.
MOST_CROSSINGS = 64


@dataclass(frozen=True)
class Crossings:
    """Crossings of lines with faces, one row per line, ordered along it."""

    #: ndarray of int, shape (lines, crossings): Index among ``model.surfaces``; -1 after the last
    #: crossing.
    surface: np.ndarray
    #: ndarray of bool, same shape: Whether the line comes from the interior side.
    from_behind: np.ndarray
    #: ndarray of float64, same shape: Distance from the line's start in mm; infinite after the last
    #: crossing.
    distance: np.ndarray
    #: ndarray of float64, shape (lines, 3)
    origin: np.ndarray
    direction: np.ndarray

    def point(self, line, crossing) -> np.ndarray:
        """Position (mm) of a crossing."""
        return self.origin[line] + self.distance[line, crossing] * self.direction[line]


def probe_lines(model: SceneModel, seed: int = 0, per_shape: int = 1500):
    """Lines that come from outside and go through all parts of a scene.

    Half of a flat face's lines aim close to its rim, where faces that should meet may not.

    Returns
    -------
    origin, direction : ndarray of float64, shape (lines, 3)
    """
    rng = np.random.default_rng(seed)
    targets = []
    for shape in model.shapes:
        box = shape.bbox()
        lower, upper = np.array(box.min, dtype=float), np.array(box.max, dtype=float)
        targets.append(lower + (upper - lower) * rng.random((per_shape, 3)))
    faces = model.faces or ()
    of_shape = Counter(face.surface for face in faces)
    for face in faces:
        # a shape of many faces, such as chamfers, needs no more lines than a few large ones do
        along = rng.random((per_shape // max(2, of_shape[face.surface] // 2), 2))
        side = rng.integers(0, 4, len(along))
        across = 1e-3 * rng.standard_normal(len(along))
        a = np.choose(side, [across, 1 + across, along[:, 0], along[:, 0]])
        b = np.choose(side, [along[:, 1], along[:, 1], across, 1 + across])
        targets.append(face.corner + a[:, None] * face.edge_u + b[:, None] * face.edge_v)
    target = np.concatenate(targets)
    direction = rng.standard_normal(target.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return target - 4.0 * model.size_mm * direction, direction


def trace_crossings(model: SceneModel, origin, direction) -> Crossings:
    """All crossings of the lines, exactly for flat faces, by Mitsuba's intersection otherwise."""
    if model.faces is not None:
        return _through_flat_faces(model, origin, direction)
    return _through_any_shapes(model, origin, direction)


def _through_flat_faces(model, origin, direction) -> Crossings:
    distance = np.full((len(origin), len(model.faces)), np.inf)
    behind = np.zeros(distance.shape, dtype=bool)
    ambiguous = np.zeros(len(origin), dtype=bool)
    for number, face in enumerate(model.faces):
        towards = direction @ face.normal
        behind[:, number] = towards > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (face.corner @ face.normal - origin @ face.normal) / towards
            dual = np.linalg.inv(np.column_stack([face.edge_u, face.edge_v, face.normal]))
            a, b = (origin @ v + t * (direction @ v) - face.corner @ v for v in dual[:2])
            margin = np.minimum(a, b)
            margin = np.minimum(margin, 1 - a - b if face.triangle else 1 - np.maximum(a, b))
        rim = RIM * model.size_mm / min(np.linalg.norm(face.edge_u), np.linalg.norm(face.edge_v))
        ambiguous |= np.abs(margin) <= rim
        distance[:, number] = np.where((margin > 0) & (t > 0), t, np.inf)
    origin, direction = origin[~ambiguous], direction[~ambiguous]
    distance, behind = distance[~ambiguous], behind[~ambiguous]
    order = np.argsort(distance, axis=1, kind="stable")
    distance = np.take_along_axis(distance, order, axis=1)
    most = max(int(np.isfinite(distance).sum(axis=1).max()), 1)
    distance, order = distance[:, :most], order[:, :most]
    surface_of = np.array([face.surface for face in model.faces])
    surface = np.where(np.isfinite(distance), surface_of[order], -1)
    from_behind = np.take_along_axis(behind, order, axis=1)
    return Crossings(surface, from_behind, distance, origin, direction)


def _through_any_shapes(model, origin, direction) -> Crossings:
    import drjit as dr
    import mitsuba as mi

    from mcrim_mitsuba.transport.scene_model import surface_numbers

    number_of = surface_numbers(model)
    start = mi.Point3f(origin.T.astype(np.float32))
    along = mi.Vector3f(direction.T.astype(np.float32))
    ray, columns = mi.Ray3f(start, along), []
    alive = np.ones(len(origin), dtype=bool)
    for _ in range(MOST_CROSSINGS):
        si = model.scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
        hit = si.is_valid()
        number = number_of(si.shape, hit)
        reached = dr.dot(si.p - start, along)
        behind = dr.dot(si.n, along) > 0
        ray = si.spawn_ray(along)
        dr.eval(hit, number, reached, behind, ray)
        # a line that has left has no position to go on from
        alive = alive & np.array(hit)
        columns.append(
            (
                np.where(alive, np.array(number).astype(int), -1),
                np.array(behind),
                np.where(alive, np.array(reached, dtype=float), np.inf),
            )
        )
        if not alive.any():
            break
    surface, behind, distance = (np.stack(rows, axis=1) for rows in zip(*columns, strict=True))
    return Crossings(surface, behind, distance, origin, direction)


# Keeps the books of volumes entered and left along straight lines through a scene.
#
# Coming from outside, a line is in a volume that the last face named, with the index
# that this face gave; the next face must say the same of its near side. Where they disagree,
# hypotheses are tried: one face is reversed; volumes overlap; a volume is not closed.

#: Indices that differ by less are the same (single precision keeps seven digits).
SAME_INDEX = 1e-6
#: Fraction of a volume's lines that leave through a hole above which a whole face is missing.
FACE_MISSING = 0.03


@dataclass(frozen=True)
class Books:
    """Sides of all crossings, one row per line."""

    #: ndarray of int, shape (lines, crossings): Volume before and after the crossing.
    near: np.ndarray
    far: np.ndarray
    #: ndarray of float: Index before and after; NaN where the face names none.
    n_near: np.ndarray
    n_far: np.ndarray
    #: ndarray of bool: Whether there is such a crossing.
    valid: np.ndarray

    def contradictions(self) -> np.ndarray:
        """Where a crossing disagrees with the one before it (bool, shape (lines, crossings + 1)).

        The last column stands for leaving the scene, where everything must be outside.
        """
        lines = len(self.near)
        volume, index = np.zeros(lines, dtype=int), np.full(lines, np.nan)
        wrong = np.zeros((lines, self.near.shape[1] + 1), dtype=bool)
        for i in range(self.near.shape[1]):
            valid = self.valid[:, i]
            differs = np.abs(self.n_near[:, i] - index) > SAME_INDEX  # False where unknown
            wrong[:, i] = valid & ((self.near[:, i] != volume) | differs)
            volume = np.where(valid, self.far[:, i], volume)
            index = np.where(valid, self.n_far[:, i], index)
        wrong[:, -1] = volume != 0
        return wrong


def keep_books(
    crossings: Crossings, surfaces: Sequence[Surface], interfaces: tuple[Interface, ...]
) -> Books:
    """Sides of the crossings, from the faces' media and the indices written in the scene.

    Parameters
    ----------
    crossings : kernel.crossings.Crossings
    surfaces : sequence of kernel.scene_model.Surface
    interfaces : tuple of Interface
        In the order of `surfaces`.
    """
    interior = np.array([s.interior for s in surfaces])[crossings.surface]
    exterior = np.array([s.exterior for s in surfaces])[crossings.surface]
    unknown = float("nan")
    n_in = np.array([unknown if i.n_interior is None else i.n_interior for i in interfaces])
    n_out = np.array([unknown if i.n_exterior is None else i.n_exterior for i in interfaces])
    n_in, n_out = n_in[crossings.surface], n_out[crossings.surface]
    behind = crossings.from_behind
    return Books(
        near=np.where(behind, interior, exterior),
        far=np.where(behind, exterior, interior),
        n_near=np.where(behind, n_in, n_out),
        n_far=np.where(behind, n_out, n_in),
        valid=crossings.surface >= 0,
    )


def problems_of_books(
    file: SceneFile, model: SceneModel, interfaces: tuple[Interface, ...], crossings: Crossings
) -> list[SceneProblem]:
    """What the contradictions in the books mean, each as one problem."""
    books = keep_books(crossings, model.surfaces, interfaces)
    wrong = books.contradictions()
    if not wrong.any():
        return []
    return (
        _reversed(file, interfaces, crossings, books, wrong)
        or _open_or_overlapping(file, model, interfaces, crossings, books)
        or _indices(file, interfaces, crossings, books, wrong)
    )


def problems_of_named_volumes(interfaces: tuple[Interface, ...]) -> list[SceneProblem]:
    """Faces that give one and the same volume different indices."""
    claims: dict[str, list[tuple[float, Interface]]] = {}
    for face in interfaces:
        for volume, index in (
            (face.interior, face.n_interior),
            (face.exterior, face.n_exterior),
        ):
            # Parts without a medium are all "outside" and may differ: the books judge them.
            if index is not None and volume != "outside":
                claims.setdefault(volume, []).append((index, face))
    problems = []
    for volume, said in claims.items():
        counted = Counter(index for index, _ in said)
        usual = max(counted, key=lambda index: (counted[index], -index))
        rest = [(index, face) for index, face in said if abs(index - usual) > SAME_INDEX]
        if not rest:
            continue
        index, face = rest[0]
        other = next(f for i, f in said if i == usual)
        problems.append(
            SceneProblem(
                "index",
                f"{face.surface} gives the {volume} the index {index:g}, but {other.surface} "
                f"(line {other.line}) gives it {usual:g}",
                f"let both name the same index for the {volume}",
                face.path,
                face.line,
            )
        )
    return problems


def _reversed(
    file: SceneFile,
    interfaces: tuple[Interface, ...],
    crossings: Crossings,
    books: Books,
    wrong: np.ndarray,
) -> list[SceneProblem]:
    """A face whose two sides are exchanged: exchanging them again mends (nearly) everything."""
    contradictions = int(wrong.sum())
    suspects = Counter(crossings.surface[wrong[:, :-1]].tolist())
    problems = []
    for number, _ in suspects.most_common():
        flip = crossings.surface == number
        mended = Books(
            near=np.where(flip, books.far, books.near),
            far=np.where(flip, books.near, books.far),
            n_near=np.where(flip, books.n_far, books.n_near),
            n_far=np.where(flip, books.n_near, books.n_far),
            valid=books.valid,
        )
        left = int(mended.contradictions().sum())
        # every crossing of a reversed face contradicts the ones on both of its sides
        if contradictions - left >= int(flip.sum()):
            face = interfaces[number]
            problems.append(
                SceneProblem(
                    "reversed_face",
                    f"{face.surface} is reversed: its normal points into the {face.interior}, "
                    "which it calls its interior",
                    "turn it by 180 degrees, or exchange int_ior with ext_ior and interior "
                    "with exterior",
                    face.path,
                    face.line,
                )
            )
            books, contradictions = mended, left
            if not left:
                break
    return problems


def _open_or_overlapping(
    file: SceneFile,
    model: SceneModel,
    interfaces: tuple[Interface, ...],
    crossings: Crossings,
    books: Books,
) -> list[SceneProblem]:
    """Volumes with a hole; or closed volumes that reach into each other."""
    problems: list[SceneProblem] = []
    overlaps: Counter[tuple[int, ...]] = Counter()
    names = model.volume_names
    for number in range(1, len(names)):
        enters = (books.far == number) & books.valid & (books.near != number)
        leaves = (books.near == number) & books.valid & (books.far != number)
        change = enters.astype(int) - leaves.astype(int)
        inside = np.cumsum(change, axis=1)
        visited = (enters | leaves).any(axis=1)
        # a closed volume is entered and left in turn, and left at the end
        broken = visited & (
            (inside < 0).any(axis=1) | (inside > 1).any(axis=1) | (inside[:, -1] != 0)
        )
        if broken.any():
            problems.append(_hole(file, model, crossings, number, visited, broken))
            continue
        for other in range(1, number):
            depth = np.cumsum(
                ((books.far == other) & books.valid).astype(int)
                - ((books.near == other) & books.valid).astype(int),
                axis=1,
            )
            both = (inside > 0) & (depth > 0) & books.valid
            if both.any():
                overlaps[(other, number)] = int(both.sum())
    if problems:
        return problems
    for (one, other), _ in overlaps.most_common():
        path, line = _first_face(interfaces, names[other])
        problems.append(
            SceneProblem(
                "overlap",
                f"the volumes {names[one]!r} and {names[other]!r} overlap",
                "move or resize one of them so that they share one face at most",
                path,
                line,
            )
        )
    return problems


def _hole(
    file: SceneFile,
    model: SceneModel,
    crossings: Crossings,
    number: int,
    visited: np.ndarray,
    broken: np.ndarray,
) -> SceneProblem:
    name = model.volumes[number].name
    fraction = broken.sum() / visited.sum()
    owned = [i for i, s in enumerate(model.surfaces) if number in (s.interior, s.exterior)]
    boxes = [model.shapes[i].bbox() for i in owned]
    lower = np.min([np.array(b.min, dtype=float) for b in boxes], axis=0)
    upper = np.max([np.array(b.max, dtype=float) for b in boxes], axis=0)
    where = _unguarded_side(crossings, np.flatnonzero(broken), owned, lower, upper)
    text = f"the volume {name!r} is not closed {where}: "
    if fraction > FACE_MISSING:
        kind, text = "missing_face", text + "a face is missing"
        mend = f"add the missing face, with {name!r} as its interior"
    else:
        kind, text = "leak", text + f"light leaks there ({100 * fraction:.2g} % of test lines)"
        mend = "let its faces meet edge to edge"
    return SceneProblem(kind, text, mend, *file.place_of_id(name))


def _unguarded_side(
    crossings: Crossings, lines: np.ndarray, owned: list[int], lower: np.ndarray, upper: np.ndarray
) -> str:
    """Side of a volume's box that lines pass without meeting one of its faces."""
    sides: Counter[tuple[int, float]] = Counter()
    size = (upper - lower).max()
    own = np.isin(crossings.surface, owned)
    for line in lines[:400]:
        o, d = crossings.origin[line], crossings.direction[line]
        with np.errstate(divide="ignore"):
            t = np.array([(lower - o) / d, (upper - o) / d])
        entry, leave = t.min(axis=0).max(), t.max(axis=0).min()
        if not entry < leave:
            continue
        met = crossings.distance[line][own[line]]
        for distance, pick in ((entry, t.min(axis=0).argmax()), (leave, t.max(axis=0).argmin())):
            if not (np.abs(met - distance) < 1e-3 * size).any():
                high = abs((o + distance * d)[pick] - upper[pick]) < 1e-6 * size
                sides[(int(pick), bool(high))] += 1
    if not sides:
        return "somewhere"
    (axis, high), _ = sides.most_common(1)[0]
    place = (upper if high else lower)[axis]
    return f"at {'xyz'[axis]} = {round(place, 5) + 0.0:.4g} mm"


def _indices(
    file: SceneFile,
    interfaces: tuple[Interface, ...],
    crossings: Crossings,
    books: Books,
    wrong: np.ndarray,
) -> list[SceneProblem]:
    """Neighbouring faces that give the space between them different indices."""
    pairs: Counter[tuple[int, int, float, float]] = Counter()
    for line, i in zip(*np.nonzero(wrong[:, :-1]), strict=True):
        before = crossings.surface[line, i - 1] if i else -1
        n = books.n_far[line, i - 1] if i else 1.0
        pairs[(int(before), int(crossings.surface[line, i]), float(n),
               float(books.n_near[line, i]))] += 1  # fmt: skip
    if not pairs:
        return []
    (before, after, n_before, n_after), _ = pairs.most_common(1)[0]
    face = interfaces[after]
    if np.isnan(n_after) or np.isnan(n_before):
        other = interfaces[before].surface if before >= 0 else "the outside"
        return [
            SceneProblem(
                "overlap",
                f"{face.surface} stands inside a volume that it does not border: between it and "
                f"{other} the volume changes without a face",
                "move it out, or name the volume as its interior or exterior",
                face.path,
                face.line,
            )
        ]
    if before < 0:
        other = "outside is air, 1"
    else:
        other = f"{interfaces[before].surface} (line {interfaces[before].line}) says {n_before:g}"
    return [
        SceneProblem(
            "index",
            f"{face.surface} says that the index beside it is {n_after:g}, but {other}",
            "let the faces around one space name the same index for it",
            face.path,
            face.line,
        )
    ]


def _first_face(interfaces: tuple[Interface, ...], volume: str) -> tuple[Path, int | None]:
    face = next(f for f in interfaces if volume in (f.interior, f.exterior))
    return face.path, face.line
