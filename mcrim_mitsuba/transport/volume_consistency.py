"""Whether the volumes of a scene fit together, by straight lines through it.

Coming from outside, a line is in the volume that the last face named, with the index
that this face gave; the next face must say the same of its near side. Where they disagree,
hypotheses are tried: one face is reversed; volumes overlap; a volume is not closed.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.scene.check_text import Interface, SceneProblem
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.scene_model import Kept, SceneModel, box_of

#: Lines that pass closer than this (relative to the scene's size) to a face's rim are left out:
#: there rounding of single precision positions decides which of two faces is met.
RIM = 1e-6
#: Crossings followed along one line of a scene with curved faces.
MOST_CROSSINGS = 64
#: Indices that differ by less are the same (single precision keeps seven digits).
SAME_INDEX = 1e-6
#: Fraction of a volume's lines that leave through a hole above which a whole face is missing.
FACE_MISSING = 0.03
#: Degrees by which a face that meets no neighbour may be off the way it was meant to lie: less is
#: rounding, more is no tilt.
TILTS = 1e-3, 30.0


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


def probe_lines(model: SceneModel) -> tuple[np.ndarray, np.ndarray]:
    """Lines that come from outside and go through all parts of a scene.

    Their origins and directions: float64, shape (lines, 3). Half of a flat face's lines aim close
    to its rim, where faces that should meet may not.
    """
    rng, per_shape = np.random.default_rng(0), 1500
    targets = []
    for shape in model.shapes:
        lower, upper = box_of(shape)
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


#: By geometry; of one bench they take 5 MB.
_known_crossings = Kept[Crossings](2)


def probe(model: SceneModel) -> Crossings:
    """Crossings of the `probe_lines` of a scene."""
    if model.faces is None:
        return trace_crossings(model, *probe_lines(model))
    return _known_crossings.of(model.geometry, lambda: trace_crossings(model, *probe_lines(model)))


def trace_crossings(model: SceneModel, origin, direction) -> Crossings:
    """All crossings of the lines, exactly for flat faces, by Mitsuba's intersection otherwise."""
    if model.faces is None:
        return _through_any_shapes(model, origin, direction)
    # numbers that are used together lie together
    distance = np.full((len(model.faces) + 2 * len(model.walls), len(origin)), np.inf)
    behind = np.zeros(distance.shape, dtype=bool)
    ambiguous = np.zeros(len(origin), dtype=bool)
    starts, ways = np.ascontiguousarray(origin.T), np.ascontiguousarray(direction.T)
    for number, face in enumerate(model.faces):
        t, margin, behind[number] = face.meeting(starts, ways)
        rim = RIM * model.size_mm / min(np.linalg.norm(face.edge_u), np.linalg.norm(face.edge_v))
        ambiguous |= np.abs(margin) <= rim
        distance[number] = np.where((margin > 0) & (t > 0), t, np.inf)
    width = RIM * model.size_mm
    for number, (wall, sign) in enumerate(itertools.product(model.walls, (-1.0, 1.0))):
        column, circle = len(model.faces) + number, wall.circle
        away, along = origin[:, circle.across] - circle.centre_mm, direction[:, circle.across]
        a, b = (along**2).sum(axis=1), (away * along).sum(axis=1)
        c = (away**2).sum(axis=1) - circle.radius_mm**2
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (-b + sign * np.sqrt(b * b - a * c)) / a
            margin = wall.margin(origin + t[:, None] * direction)
            nearest = np.sqrt(np.maximum(c + circle.radius_mm**2 - b * b / a, 0.0))
        ambiguous |= (np.abs(margin) <= width) | (np.abs(nearest - circle.radius_mm) <= width)
        distance[column] = np.where((margin > 0) & (t > 0), t, np.inf)
        behind[column] = (sign > 0) == wall.outwards
    origin, direction = origin[~ambiguous], direction[~ambiguous]
    distance, behind = distance.T[~ambiguous], behind.T[~ambiguous]
    most = max(int(np.isfinite(distance).sum(axis=1).max()), 1)
    order = np.argsort(distance, axis=1, kind="stable")[:, :most]
    distance = np.take_along_axis(distance, order, axis=1)
    walls = [wall.surface for wall in model.walls for _ in range(2)]
    surface_of = np.array([face.surface for face in model.faces] + walls)
    surface = np.where(np.isfinite(distance), surface_of[order], -1)
    from_behind = np.take_along_axis(behind, order, axis=1)
    return Crossings(surface, from_behind, distance, origin, direction)


def _through_any_shapes(model, origin, direction) -> Crossings:
    import drjit as dr
    import mitsuba as mi

    from mcrim_mitsuba.transport.conversion import surface_numbers

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
        surface = np.where(alive, np.array(number).astype(int), -1)
        distance = np.where(alive, np.array(reached, dtype=float), np.inf)
        columns.append((surface, np.array(behind), distance))
        if not alive.any():
            break
    surface, behind, distance = (np.stack(rows, axis=1) for rows in zip(*columns, strict=True))
    return Crossings(surface, behind, distance, origin, direction)


@dataclass(frozen=True)
class Sides:
    """What faces say of their two sides at all crossings; arrays of shape (lines, crossings)."""

    #: ndarray of int: Volume before and after the crossing.
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
        for i, valid in enumerate(self.valid.T):
            differs = np.abs(self.n_near[:, i] - index) > SAME_INDEX  # False where unknown
            wrong[:, i] = valid & ((self.near[:, i] != volume) | differs)
            volume = np.where(valid, self.far[:, i], volume)
            index = np.where(valid, self.n_far[:, i], index)
        wrong[:, -1] = volume != 0
        return wrong

    def exchanged(self, where: np.ndarray) -> Sides:
        """These sides with near and far exchanged at some crossings."""
        turned = {"near": "far", "far": "near", "n_near": "n_far", "n_far": "n_near"}
        values = {a: np.where(where, getattr(self, b), getattr(self, a)) for a, b in turned.items()}
        return Sides(valid=self.valid, **values)

    def depth(self, volume: int) -> np.ndarray:
        """How often a volume was entered more than left (int), after every crossing."""
        entered, left = self.far == volume, self.near == volume
        return np.cumsum((entered & self.valid).astype(int) - (left & self.valid), axis=1)


def problems_of_volumes(
    file: SceneFile, model: SceneModel, interfaces: tuple[Interface, ...], crossings: Crossings
) -> list[SceneProblem]:
    """What contradictions along the lines mean; `interfaces` are of the model's surfaces."""
    rows = []
    for surface, face in zip(model.surfaces, interfaces, strict=True):
        named = (surface.exterior, face.n_exterior), (surface.interior, face.n_interior)
        # a volume without end lies where outside does, whatever the index there
        ends = [(0, None) if side == model.endless else (side, n) for side, n in named]
        rows.append([part for pair in zip(*ends, strict=True) for part in pair])
    # volumes are small integers, exact as floats; an index that is not named is nan
    near, far, n_near, n_far = np.array(rows, dtype=float).T[:, crossings.surface]
    sides = Sides(near, far, n_near, n_far, crossings.surface >= 0)
    judge = _Judge(file, model, interfaces, crossings, sides.exchanged(crossings.from_behind))
    if not judge.wrong.any():
        return []
    return judge.reversed_faces() or judge.open_or_overlapping() or judge.neighbours()


def problems_of_named_volumes(interfaces: tuple[Interface, ...]) -> list[SceneProblem]:
    """Faces that give one and the same volume different indices."""
    problems = []
    for volume, claims in claimed_indices(interfaces).items():
        counted = Counter(index for index, _ in claims)
        usual = max(counted, key=lambda index: (counted[index], -index))
        rest = [(index, face) for index, face in claims if abs(index - usual) > SAME_INDEX]
        if rest:
            index, face = rest[0]
            other = next(f for i, f in claims if i == usual)
            text = (
                f"{face.surface} gives the {volume} the index {index:g}, but {other.surface} "
                f"(line {other.line}) gives it {usual:g}"
            )
            mend = f"let both name the same index for the {volume}"
            problems.append(_at(face, "index", text, mend))
    return problems


def claimed_indices(interfaces: Iterable[Interface]) -> dict[str, list[tuple[float, Interface]]]:
    """What faces say of the index of every named volume; what is outside may differ."""
    claims: dict[str, list[tuple[float, Interface]]] = {}
    for face in interfaces:
        for volume, index in (face.interior, face.n_interior), (face.exterior, face.n_exterior):
            if index is not None and volume != "outside":
                claims.setdefault(volume, []).append((index, face))
    return claims


def _at(face: Interface, kind: str, text: str, mend: str) -> SceneProblem:
    return SceneProblem(kind, text, mend, face.path, face.line)


@dataclass
class _Judge:
    """The hypotheses that can explain contradictions along lines."""

    _file: SceneFile
    _model: SceneModel
    _interfaces: tuple[Interface, ...]
    _crossings: Crossings
    _sides: Sides

    def __post_init__(self) -> None:
        self.wrong = self._sides.contradictions()

    def reversed_faces(self) -> list[SceneProblem]:
        """Faces whose sides are exchanged: exchanging them again mends (nearly) everything."""
        sides, surface, contradictions = self._sides, self._crossings.surface, self.wrong.sum()
        problems = []
        for number, _ in Counter(surface[self.wrong[:, :-1]].tolist()).most_common():
            flip = surface == number
            mended = sides.exchanged(flip)
            left = mended.contradictions().sum()
            # every crossing of a reversed face contradicts the ones on both of its sides
            if contradictions - left >= flip.sum():
                face = self._interfaces[number]
                text = (
                    f"{face.surface} is reversed: its normal points into the {face.interior}, "
                    "which it calls its interior"
                )
                mend = (
                    "turn it by 180 degrees, or exchange int_ior with ext_ior and interior "
                    "with exterior"
                )
                problems.append(_at(face, "reversed_face", text, mend))
                sides, contradictions = mended, left
                if not left:
                    break
        return problems

    def open_or_overlapping(self) -> list[SceneProblem]:
        """Volumes with a hole; or closed volumes that reach into each other."""
        sides, names = self._sides, self._model.volume_names
        problems: list[SceneProblem] = []
        overlaps: Counter[tuple[int, int]] = Counter()
        for number in range(1, len(names)):
            inside = sides.depth(number)
            visited = (((sides.far == number) != (sides.near == number)) & sides.valid).any(axis=1)
            # a closed volume is entered and left in turn, and left at the end
            outside_in = (inside < 0).any(axis=1) | (inside > 1).any(axis=1) | (inside[:, -1] != 0)
            broken = visited & outside_in
            if broken.any():
                fraction = broken.sum() / visited.sum()
                problems.append(self._hole(number, np.flatnonzero(broken), fraction))
                continue
            for other in range(1, number):
                both = (inside > 0) & (sides.depth(other) > 0) & sides.valid
                if both.any():
                    overlaps[other, number] = int(both.sum())
        if problems:
            # one tilted face opens both of its volumes
            return list(dict.fromkeys(problems))
        for (first, other), _ in overlaps.most_common():
            face = next(f for f in self._interfaces if names[other] in (f.interior, f.exterior))
            text = f"the volumes {names[first]!r} and {names[other]!r} overlap"
            mend = "move or resize one of them so that they share one face at most"
            problems.append(_at(face, "overlap", text, mend))
        return problems

    def _hole(self, volume: int, lines: np.ndarray, fraction: float) -> SceneProblem:
        """What `lines` find that enter a volume and do not leave it, or the other way round."""
        name = self._model.volume_names[volume]
        if (tilted := self._tilted(volume)) is not None:
            return tilted
        side = self._unguarded_side(lines, volume)
        where = "somewhere" if side is None else f"at {'xyz'[side[0]]} = {side[1]:.4g} mm"
        text = f"the volume {name!r} is not closed {where}: "
        if side is not None and (silent := self._silent_face(volume, *side)) is not None:
            face, ref = silent
            text += f"{face.surface} lies there and does not name it"
            mend = f'add <ref name="{ref}" id="{name}"/> to {face.surface}'
            return _at(face, "missing_face", text, mend)
        if fraction > FACE_MISSING:
            kind, text = "missing_face", text + "a face is missing"
            mend = f"add the missing face, with {name!r} as its interior"
        else:
            kind, text = "leak", text + f"light leaks there ({100 * fraction:.2g} % of test lines)"
            mend = "let its faces meet edge to edge"
        return SceneProblem(kind, text, mend, *self._file.place_of_id(name))

    def _tilted(self, volume: int) -> SceneProblem | None:
        """A flat face of a volume that lies askew, so that it does not meet its neighbours."""
        faces = [f for f in self._model.flat_faces if f.surface in self._model.bordering(volume)]
        near, tilted = RIM * self._model.size_mm, []
        for face in faces:
            others = [other for other in faces if other.surface != face.surface]
            corners = face.corners
            met = np.zeros(len(corners), dtype=bool)
            for other in others:
                beside = np.abs((corners - other.corner) @ other.normal) < near
                edge = min(np.linalg.norm(other.edge_u), np.linalg.norm(other.edge_v))
                met |= beside & (other.margin(corners) > -near / edge)
            # as it was meant: along another face of the volume, or else along an axis
            meant = {self._interfaces[other.surface].surface: other.normal for other in others}
            axes = zip(("y and z", "x and z", "x and y"), np.eye(3), strict=True)
            meant |= {f"the plane of {two}": axis for two, axis in axes}
            sines = {n: float(np.linalg.norm(np.cross(face.normal, v))) for n, v in meant.items()}
            what = min(sines, key=lambda name: round(sines[name], 6))
            degrees = math.degrees(math.asin(min(sines[what], 1.0)))
            if TILTS[0] < degrees < TILTS[1] and 2 * met.sum() <= len(corners):
                tilted.append((int(met.sum()), degrees, what, self._interfaces[face.surface]))
        if not tilted:
            return None
        _, degrees, what, face_of = min(tilted, key=lambda other: other[:2])
        text = f"{face_of.surface} is tilted by {degrees:.3g} degrees against {what}"
        mend = "turn it back in its <transform>: as it lies, it does not meet its neighbours"
        return _at(face_of, "tilted_face", text, mend)

    def _silent_face(self, volume: int, axis: int, place: float) -> tuple[Interface, str] | None:
        """A face on a side of a volume's box that says nothing of it; and which side of it is."""
        lower, upper = self._model.bounds(volume)
        near = RIM * self._model.size_mm
        others = [i for i in range(3) if i != axis]
        for face in self._model.flat_faces:
            sides = self._model.surfaces[face.surface].sides
            corners = face.corners
            if volume in sides or (np.abs(corners[:, axis] - place) > near).any():
                continue
            low, high = corners.min(axis=0)[others], corners.max(axis=0)[others]
            if (np.minimum(high, upper[others]) - np.maximum(low, lower[others]) < near).any():
                continue
            in_front = bool(((lower + upper)[axis] / 2 - place) * face.normal[axis] > 0)
            if sides[in_front] == 0:
                return self._interfaces[face.surface], "exterior" if in_front else "interior"
        return None

    def _unguarded_side(self, lines: np.ndarray, volume: int) -> tuple[int, float] | None:
        """Axis and place in mm of the side of a volume's box that lines pass without a face."""
        crossings, sides = self._crossings, Counter[tuple[int, bool]]()
        lower, upper = self._model.bounds(volume)
        size = (upper - lower).max()
        of_volume = np.isin(crossings.surface, self._model.bordering(volume))
        for line in lines[:400]:
            o, d = crossings.origin[line], crossings.direction[line]
            with np.errstate(divide="ignore"):
                t = np.array([(lower - o) / d, (upper - o) / d])
            first, last = t.min(axis=0), t.max(axis=0)
            if not first.max() < last.min():
                continue
            met = crossings.distance[line][of_volume[line]]
            ends = (first.max(), int(first.argmax())), (last.min(), int(last.argmin()))
            for distance, axis in ends:
                if not (np.abs(met - distance) < 1e-3 * size).any():
                    high = abs((o + distance * d)[axis] - upper[axis]) < 1e-6 * size
                    sides[axis, bool(high)] += 1
        if not sides:
            return None
        (axis, high), _ = sides.most_common(1)[0]
        return axis, round(float((upper if high else lower)[axis]), 5) + 0.0

    def neighbours(self) -> list[SceneProblem]:
        """Neighbouring faces that give the space between them different indices."""
        surface, sides = self._crossings.surface, self._sides
        pairs: Counter[tuple[int, int, float, float]] = Counter()
        for line, i in zip(*np.nonzero(self.wrong[:, :-1]), strict=True):
            before, n = (surface[line, i - 1], sides.n_far[line, i - 1]) if i else (-1, 1.0)
            pairs[int(before), int(surface[line, i]), float(n), float(sides.n_near[line, i])] += 1
        if not pairs:
            return []
        (before, after, n_before, n_after), _ = pairs.most_common(1)[0]
        face, other = self._interfaces[after], self._interfaces[before] if before >= 0 else None
        if np.isnan(n_after) or np.isnan(n_before):
            text = (
                f"{face.surface} stands inside a volume that it does not border: between it and "
                f"{other.surface if other else 'the outside'} the volume changes without a face"
            )
            mend = "move it out, or name the volume as its interior or exterior"
            return [_at(face, "overlap", text, mend)]
        if n_before == n_after:
            what = f"{face.surface} and {other.surface if other else 'what is outside'} name"
            text = f"{what} different volumes for the space between them"
            mend = "let both name the same one, as their interior or exterior, or none"
            return [_at(face, "overlap", text, mend)]
        says = "outside is air, 1"
        if other:
            says = f"{other.surface} (line {other.line}) says {n_before:g}"
        text = f"{face.surface} says that the index beside it is {n_after:g}, but {says}"
        mend = "let the faces around one space name the same index for it"
        return [_at(face, "index", text, mend)]
