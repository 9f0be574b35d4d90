"""The bench by its parameters, as scenes name them, for what knows no scenes.

The solver without photons (`polished_box`), the NumPy tracer and Geant4 are told their bench so."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from mcrim_mitsuba.core.errors import InputError

#: A gap is filled where its nominal index is above this.
FILLED_ABOVE = 1.0005
#: Distance of a reflecting sheet from the crystal's top face.
TOP_FILM_MM = 0.01
#: Distance of the plate that detects a beam from where the beam leaves the crystal.
PLATE_DISTANCE_MM = 0.005
#: Width of the narrow collar of liquid around the foot of a crystal.
NARROW_COLLAR_WIDTH_MM = 1.0

#: What is nothing to a crystal alone in air.
NOT_IN_A_BEAM = (
    "wrap_reflectance",
    "top_reflectance",
    "bubble_fraction",
    "bubble_area_fraction",
    "aperture_at_detector",
    "detector_reflectance",
    "detector_specular",
    "cathode_nm",
    "angular_falloff",
    "radial_falloff",
    "mask_offset_mm",
    "housing_reflectance",
    "collar_mm",
    "narrow_collar_mm",
)
#: What a box has, and a cylinder has not.
NOT_ON_A_CYLINDER = (
    "wrap_reflectance",
    "top_reflectance",
    "bubble_fraction",
    "bubble_area_fraction",
    "chamfer_mm",
    "collar_mm",
    "narrow_collar_mm",
    "black_spot_mm",
    "beam_diameter_mm",
)
_OF_SOME_FACES = ("top_roughness_alpha", "side_roughness_alpha", "bottom_roughness_alpha")
#: What is alone: in which words, and beside what it may not be. A wrapping's film is closed: its
#: open rim would have to lead into the gap, or the wrapping be there twice.
_ALONE = {
    "roughness_alpha": ("where all faces are rough", _OF_SOME_FACES),
    "beam_diameter_mm": ("in a beam", NOT_IN_A_BEAM),
    "cathode_nm": (
        "where the detector is a film",
        ("detector_reflectance", "detector_specular", "angular_falloff"),
    ),
    "narrow_collar_mm": (
        "where gel stands around the crystal",
        ("chamfer_mm", "bubble_fraction", "bubble_area_fraction", "wrap_reflectance", "collar_mm"),
    ),
    "bubble_area_fraction": ("where a round bubble is", ("bubble_fraction", "chamfer_mm")),
    "collar_mm": (
        "where gel creeps up the crystal",
        ("wrap_reflectance", "gap_absorption_per_cm"),
    ),
    "wrap_reflectance": (
        "for a wrapped crystal",
        ("chamfer_mm", "bubble_fraction", "top_reflectance"),
    ),
}
#: Where the photocathode's index is known.
CATHODE_WAVELENGTHS_NM = (380.0, 680.0)
#: Axes that a beam may fly along.
BEAM_AXES = ("x", "y", "z")


def _between(default: Any, lowest: float, highest: float) -> Any:
    """A field whose value is a number from `lowest` to `highest`, or its default."""
    return field(default=default, metadata={"range": (lowest, highest)})


#: The least number above 0.
_ABOVE_0 = math.ulp(0.0)


@dataclass(frozen=True)
class Bench:
    """A scintillating crystal on a window, coupled through a thin gap.

    Lengths are in mm, coefficients in 1/cm. The defaults are the CaMoO4 bench
    of V. Alenkov et al., JINST 8 P06002 (2013).

    Raises InputError if a value has the wrong type or lies outside its range.
    """

    #: The crystal: x, y in +-width/2, z in [0, height].
    crystal_width_mm: float = 10.0
    crystal_height_mm: float = 10.0
    #: Refractive indices, at least 1 (outside is air, exactly 1).
    n_crystal: float = 2.01
    #: Isotropic bulk scattering and absorption of the crystal.
    alpha_scat_per_cm: float = 0.54
    alpha_abs_per_cm: float = 0.039
    #: Thickness of the coupling slab under the crystal's footprint.
    gap_mm: float = 0.05
    n_gap: float = 1.0
    #: The square plate under the gap; its whole back face detects.
    window_width_mm: float = 28.0
    window_thickness_mm: float = 1.0
    n_window: float = 1.52
    #: Hole of the black mask that lies on the plate's entrance face.
    aperture_radius_mm: float = 14.0
    #: Track the polarisation state instead of averaging s and p.
    polarization: bool = False
    #: Absorption in the window.
    window_absorption_per_cm: float = 0.0
    #: Reflectance, 0 to 1, of a Lambertian wrap behind an air film around the
    #: top and the four sides; None for a bare crystal. The wrap is a box open
    #: at z = 0, and its outside absorbs.
    wrap_reflectance: float | None = _between(None, 0.0, 1.0)
    #: Thickness of that air film; without meaning for a bare crystal.
    film_mm: float = 0.01
    #: Probability that light from inside a wrapped crystal finds no film before the wrap, and part
    #: of what the wrap reflects that goes as from a mirror; without meaning for a bare crystal.
    wrap_contact: float = _between(0.0, 0.0, 1.0)
    wrap_specular: float = _between(0.0, 0.0, 1.0)
    #: What follows is what the plain bench leaves out; by default it is absent.
    #: Mean cosine of Henyey and Greenstein's phase function.
    scattering_g: float = _between(0.0, -0.99, 0.99)
    #: Scatter by Rayleigh's phase function.
    rayleigh_scattering: bool = False
    #: q, from -1 to 1: the scattering coefficient is that given, times
    #: 1 + q (2 z / height - 1).
    scattering_gradient: float = _between(0.0, -1.0, 1.0)
    #: p, from 0 to 4: the scattering coefficient is that given, at ``wavelength_nm``, times
    #: (wavelength_nm / wavelength)^p; and the full width at half maximum of the light's Gaussian
    #: band about wavelength_nm, cut off at 1.5 widths.
    scattering_exponent: float = _between(0.0, 0.0, 4.0)
    bandwidth_nm: float = _between(150.0, 0.0, 1e4)
    #: Emission falls off below the top face as exp(-depth / source_depth_mm), or from the face at
    #: x = -width/2 as exp(-distance / side_depth_mm); infinity for uniform emission.
    source_depth_mm: float = _between(math.inf, _ABOVE_0, math.inf)
    side_depth_mm: float = _between(math.inf, _ABOVE_0, math.inf)
    #: GGX parameter of the crystal's faces, chamfers included, from 0
    #: (polished) to 1.
    roughness_alpha: float = _between(0.0, 0.0, 1.0)
    #: The same of the top face, of the four sides or of the bottom alone.
    top_roughness_alpha: float = _between(0.0, 0.0, 1.0)
    side_roughness_alpha: float = _between(0.0, 0.0, 1.0)
    bottom_roughness_alpha: float = _between(0.0, 0.0, 1.0)
    #: Slopes of rough faces are Beckmann's, Gaussian, with this alpha in place of GGX's.
    beckmann: bool = False
    #: Rms height of a fine roughness of the crystal's faces, chamfers included, which scatters part
    #: of what they reflect and refract; and the light's wavelength in vacuum.
    rms_roughness_nm: float = _between(0.0, 0.0, 200.0)
    wavelength_nm: float = _between(540.0, 100.0, 1e4)
    #: Fraction lost at every reflection at a crystal face back into the crystal.
    surface_loss: float = _between(0.0, 0.0, 1.0)
    #: Fraction of the light from inside that a rough face of the crystal takes before its facets
    #: reflect or refract it.
    ground_loss: float = _between(0.0, 0.0, 1.0)
    #: Leg of the 45 degree chamfers of the crystal's twelve edges. The gap
    #: keeps its footprint, and its uncovered rim borders air.
    chamfer_mm: float = _between(0.0, 0.0, math.inf)
    #: Reflectance, 0 to 1, of a Lambertian sheet of the crystal's width,
    #: `TOP_FILM_MM` above its top face; its sides are open to the air. 0 or
    #: None for no sheet.
    top_reflectance: float | None = _between(None, 0.0, 1.0)
    #: Added to ``gap_mm``.
    gap_offset_mm: float = _between(0.0, -math.inf, math.inf)
    #: Only where the gap is filled, ``n_gap`` > `FILLED_ABOVE`: added to the
    #: gap's index; the gap's absorption; the fraction of the footprint's
    #: width, from x = -width/2 on, in which the gap is open to the air.
    gap_index_offset: float = _between(0.0, -math.inf, math.inf)
    gap_absorption_per_cm: float = 0.0
    bubble_fraction: float = _between(0.0, 0.0, 0.99)
    #: Only where the gap is filled: the part of the footprint's area that a disc of air in its
    #: middle takes.
    bubble_area_fraction: float = _between(0.0, 0.0, 0.78)
    #: Only where the gap is filled: up to this height the four side faces border the liquid, in
    #: which light that leaves there goes straight on, to the plate's entrance face or away. Light
    #: from the air finds them dry.
    collar_mm: float = _between(0.0, 0.0, math.inf)
    #: The mask lies on the plate's back face instead.
    aperture_at_detector: bool = False
    #: Probability that the detector sends light back into the plate, by the
    #: cosine law.
    detector_reflectance: float = _between(0.0, 0.0, 1.0)
    #: Of other light the probability of a mirror's reflection, as by a metal.
    detector_specular: float = _between(0.0, 0.0, 1.0)
    #: Thickness of the photocathode, a film of K-Cs-Sb between the plate and vacuum, that the
    #: detector is: other light is reflected, absorbed, which is detected, or lost beyond it. 0 or
    #: None for a plain detector.
    cathode_nm: float | None = _between(None, 0.0, 200.0)
    #: Other light is detected with probability 1 - angular (1 - cos theta), over 1 - angular if
    #: that is negative, times 1 - radial (r / 14 mm)^2, else absorbed.
    angular_falloff: float = _between(0.0, -1.0, 1.0)
    radial_falloff: float = _between(0.0, 0.0, 1.0)
    #: Shift along x of the axis that r and the mask's hole are about.
    mask_offset_mm: float = _between(0.0, -math.inf, math.inf)
    #: Reflectance of the mask's upper side, by the cosine law.
    housing_reflectance: float = _between(0.0, 0.0, 1.0)
    #: With a diameter, the crystal is not on the bench but alone in air, in a beam of parallel
    #: light from outside, through its middle, along +``beam_axis``. Behind the face where the beam
    #: leaves a black plate of the face's size, `PLATE_DISTANCE_MM` away, detects light within an
    #: angle to the axis. What else the bench has beside the crystal is not there.
    beam_diameter_mm: float | None = None
    beam_axis: str = "x"
    acceptance_deg: float = _between(90.0, 0.0, 90.0)
    #: With a diameter, the crystal is a cylinder in place of a box, and ``crystal_width_mm`` is
    #: without meaning: it stands on z = 0, the gap as round as it is.
    crystal_diameter_mm: float | None = None
    #: With a length too, it lies along x, its lowest line on y = z = 0, and ``crystal_height_mm``
    #: is without meaning. The gap is a box as long as the crystal and this wide, from the window up
    #: to where it reaches the crystal's side, less the crystal.
    crystal_length_mm: float | None = None
    wetted_width_mm: float | None = None
    #: What follows has no place in the catalogue of effects: diagnoses are tried on it.
    #: Where the gap is filled, its liquid stands up to this height around the crystal's four
    #: sides, with an outer wall and a top towards air: a collar `NARROW_COLLAR_WIDTH_MM` wide.
    narrow_collar_mm: float = _between(0.0, 0.0, math.inf)
    #: Width of a black square on the middle of the top face; it absorbs what hits it.
    black_spot_mm: float = _between(0.0, 0.0, math.inf)

    def __post_init__(self) -> None:
        for attribute in fields(self):
            name, value = attribute.name, getattr(self, attribute.name)
            if isinstance(attribute.default, bool):
                _require(isinstance(value, bool), name, value, "true or false")
            elif isinstance(attribute.default, str):
                _require(value in BEAM_AXES, name, value, " or ".join(BEAM_AXES))
            elif value is None and attribute.default is None:
                continue
            else:
                # an index, a length or a coefficient
                lowest = {"mm": _ABOVE_0, "cm": 0.0}.get(name.rpartition("_")[2], 1.0)
                limits = attribute.metadata.get("range", (lowest, math.inf))
                object.__setattr__(self, name, _number(name, value, *limits))
        self._require_compatible()

    def _require_compatible(self) -> None:
        """Refuse values that do not fit each other."""
        if self.crystal_diameter_mm is None and self.crystal_length_mm is not None:
            raise InputError("crystal_length_mm is that of a cylinder", "give crystal_diameter_mm")
        if self.crystal_diameter_mm is not None:
            self._require_cylinder(self.crystal_diameter_mm)
        self._require_room()
        if self.beam_diameter_mm is not None:
            self._require_narrow_beam(self.beam_diameter_mm)
        if max(self.source_depth_mm, self.side_depth_mm) < math.inf:
            both = "source_depth_mm and side_depth_mm exclude each other"
            raise InputError(f"{both}: gammas come from one side", "leave one of them out")
        if self.rayleigh_scattering and self.scattering_g:
            both = "rayleigh_scattering and scattering_g exclude each other"
            raise InputError(f"{both}: each is a phase function", "leave one of them out")
        for name, (where, others) in _ALONE.items():
            # a wrapping that reflects nothing is there too
            if self.wrap_reflectance is not None if name == "wrap_reflectance" else self._has(name):
                self._refuse_beside(name, where, others)
        shortest, longest = CATHODE_WAVELENGTHS_NM
        if self.cathode_nm and not shortest <= self.wavelength_nm <= longest:
            problem = "the photocathode's index is not known there"
            raise InputError(
                f"wavelength_nm = {self.wavelength_nm:g}: {problem}",
                f"give {shortest:g} to {longest:g} nm",
            )

    def _require_room(self) -> None:
        """Refuse parts that are too large for their neighbours."""
        height, room, collar = self.height_mm, self.window_width_mm, self.narrow_collar_mm
        widest, width = max(self._footprint_mm.items(), key=operator.itemgetter(1))
        half = min(width, height) / 2.0
        for name, fits, expected in (
            ("window_width_mm", room >= width, f"at least {widest} = {width}"),
            ("gap_offset_mm", self.gap_thickness_mm > 0.0, f"more than -gap_mm = -{self.gap_mm}"),
            (
                "gap_index_offset",
                self.gap_index >= 1.0,
                f"an offset that leaves an index of at least 1 (n_gap = {self.n_gap})",
            ),
            (
                "bandwidth_nm",
                not self.scattering_exponent or self.bandwidth_nm < self.wavelength_nm / 1.5,
                f"less than two thirds of wavelength_nm = {self.wavelength_nm:g}",
            ),
            (
                "chamfer_mm",
                self.chamfer_mm < half,
                f"less than half of the crystal's width and height, {half:g} mm",
            ),
            ("narrow_collar_mm", collar < height, f"less than crystal_height_mm = {height}"),
            (
                "window_width_mm",
                not collar or room >= width + 2.0 * NARROW_COLLAR_WIDTH_MM,
                f"room for a collar of {NARROW_COLLAR_WIDTH_MM:g} mm around the crystal",
            ),
        ):
            _require(fits, name, getattr(self, name), expected)

    def _require_cylinder(self, diameter_mm: float) -> None:
        """Refuse a lying cylinder that does not fit its gap, and what only a box has."""
        self._refuse_beside("crystal_diameter_mm", "on a cylinder", NOT_ON_A_CYLINDER)
        depths = {"side_depth_mm": self.side_depth_mm}
        if self.crystal_length_mm is not None:
            wet = self.wetted_width_mm
            expected = f"a number below crystal_diameter_mm = {diameter_mm}"
            _require(wet is not None and wet < diameter_mm, "wetted_width_mm", wet, expected)
            depths["source_depth_mm"] = self.source_depth_mm
            self._refuse_beside("crystal_length_mm", "on a cylinder that lies", _OF_SOME_FACES)
        for name, depth in depths.items():
            if depth < math.inf:
                problem = f"the NumPy tracer has no {name} on such a cylinder"
                raise InputError(problem, f"leave {name} out")

    def _require_narrow_beam(self, beam_mm: float) -> None:
        """Refuse a beam that is wider than the crystal's side."""
        sizes = dict.fromkeys(BEAM_AXES, self.crystal_width_mm) | {"z": self.crystal_height_mm}
        narrowest = min(size for axis, size in sizes.items() if axis != self.beam_axis)
        expected = f"less than the crystal's side, {narrowest:g} mm"
        _require(beam_mm < narrowest, "beam_diameter_mm", beam_mm, expected)

    def _refuse_beside(self, name: str, where: str, others: tuple[str, ...]) -> None:
        """Refuse what the tracer does not know beside another parameter."""
        for other in others:
            if self._has(other):
                problem = f"the NumPy tracer has no {other} {where}"
                raise InputError(problem, f"leave {other} or {name} out")

    def _has(self, name: str) -> bool:
        """Whether a parameter is neither 0 nor absent."""
        return bool(getattr(self, name))

    @property
    def lies(self) -> bool:
        """Whether the crystal is a cylinder that lies."""
        return self.crystal_length_mm is not None

    @property
    def height_mm(self) -> float:
        """Of the crystal, from z = 0 up."""
        if self.crystal_diameter_mm is not None and self.lies:
            return self.crystal_diameter_mm
        return self.crystal_height_mm

    @property
    def _footprint_mm(self) -> dict[str, float]:
        """Sizes of what must have room on the window."""
        if self.crystal_diameter_mm is None:
            return {"crystal_width_mm": self.crystal_width_mm}
        if self.crystal_length_mm is None or self.wetted_width_mm is None:
            return {"crystal_diameter_mm": self.crystal_diameter_mm}
        return {
            "crystal_length_mm": self.crystal_length_mm,
            "wetted_width_mm": self.wetted_width_mm,
        }

    @property
    def wetted_height_mm(self) -> float:
        """Height at which the gap's side walls reach a lying cylinder."""
        assert self.crystal_diameter_mm is not None and self.wetted_width_mm is not None
        radius, half = self.crystal_diameter_mm / 2.0, self.wetted_width_mm / 2.0
        return half**2 / (radius + math.sqrt(radius**2 - half**2))

    @property
    def face_roughness(self) -> tuple[float, ...]:
        """GGX alpha of the crystal's -x, +x, -y, +y, bottom and top face, and of its chamfers."""
        alike = self.roughness_alpha
        sides = alike or self.side_roughness_alpha
        bottom, top = self.bottom_roughness_alpha, self.top_roughness_alpha
        return (*4 * (sides,), alike or bottom, alike or top, *12 * (alike,))

    @property
    def is_filled(self) -> bool:
        """Whether a liquid fills the gap."""
        return self.n_gap > FILLED_ABOVE

    @property
    def gap_thickness_mm(self) -> float:
        """Thickness of the gap, its offset included."""
        return self.gap_mm + self.gap_offset_mm

    @property
    def gap_index(self) -> float:
        """Index of what fills the gap, its offset included."""
        return self.n_gap + (self.gap_index_offset if self.is_filled else 0.0)

    @property
    def gap_left_mm(self) -> float:
        """The x at which the gap begins: the bubble's end, or the crystal's side."""
        bubble = self.bubble_fraction if self.is_filled else 0.0
        return (bubble - 0.5) * self.crystal_width_mm

    @property
    def bubble_radius_mm(self) -> float:
        """Of the round bubble; 0 where there is none."""
        share = self.bubble_area_fraction if self.is_filled else 0.0
        return math.sqrt(share / math.pi) * self.crystal_width_mm

    @property
    def wet_height_mm(self) -> float:
        """How far up the crystal's sides border liquid of no end; 0 where they do not."""
        return self.collar_mm if self.is_filled else 0.0

    @property
    def narrow_collar_height_mm(self) -> float:
        """How far the narrow collar stands up around the crystal; 0 where it does not."""
        return self.narrow_collar_mm if self.is_filled else 0.0

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> Bench:
        """Build a bench from scene parameters; what is not named keeps its default.

        Ground faces, a candidate of their own there, are rough ones here.

        Raises InputError for a name that is not an attribute: silently leaving a parameter out
        would make the comparison meaningless.
        """
        names = {attribute.name for attribute in fields(cls)}
        parameters = {_GROUND.get(name, name): value for name, value in parameters.items()}
        unknown = sorted(set(parameters) - names)
        if unknown:
            problem = f"the NumPy tracer cannot express {', '.join(unknown)}"
            raise InputError(problem, f"leave it out, or use only {', '.join(sorted(names))}")
        return cls(**parameters)


#: Names here of the scene's parameters of ground faces: all, or those of one side.
_GROUND = {
    f"ground_{side}alpha": f"{side}roughness_alpha" for side in ("", "top_", "side_", "bottom_")
}


def _number(name: str, value: Any, lowest: float, highest: float) -> float:
    """A number in its range as a plain float (NumPy scalars and ints come in)."""
    infinite = name in ("source_depth_mm", "side_depth_mm")
    expected = _range_in_words(lowest, highest, infinite)
    _require(not isinstance(value, (bool, str)), name, value, expected)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        _require(False, name, value, expected)
    finite = math.isfinite(number) or (infinite and number == math.inf)
    _require(finite and lowest <= number <= highest, name, value, expected)
    return number


def _range_in_words(lowest: float, highest: float, infinite: bool) -> str:
    if lowest == -math.inf:
        return "a finite number"
    if highest < math.inf:
        return f"a number from {lowest:g} to {highest:g}"
    if infinite:
        return "a number above 0, or infinity"
    if lowest == math.ulp(0.0):
        return "a finite number above 0"
    return f"a finite number, at least {lowest:g}"


def _require(condition: bool, name: str, value: Any, expected: str) -> None:
    if not condition:
        raise InputError(f"{name} = {value!r} cannot be used", f"give {expected}")
