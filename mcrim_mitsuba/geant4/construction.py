"""The bench as Geant4 volumes. Importable only in the process that `trace` starts."""

from __future__ import annotations

import math

import geant4_pybind as g4

from mcrim_mitsuba.geant4.result import CRYSTAL, DETECTOR, MASK
from mcrim_mitsuba.tracer.bench import Bench

LIGHT = "light"
#: Optical properties are given at these photon energies, and light has one in between.
_ENERGIES = g4.G4doubleVector([1.0 * g4.eV, 5.0 * g4.eV])
PHOTON_ENERGY = 3.0 * g4.eV
#: The mask, of no thickness in truth: far above Geant4's tolerance of 1e-9 mm, and so thin that
#: the hole's edge is nothing.
MASK_THICKNESS_MM = 1e-5
_DETECTOR_THICKNESS_MM = 1.0


class BenchConstruction(g4.G4VUserDetectorConstruction):
    """Crystal, gap and window in air, a mask in the window's entrance face, a detector below.

    Faces carry no optical surface: between two refractive indices Geant4 then reflects and
    refracts as polished faces do.
    """

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self._bench = bench
        self._counted: dict[str, object] = {}
        # Geant4 holds bare pointers to what Python would collect.
        self._kept: list[object] = []

    def Construct(self):
        bench = self._bench
        air = self._medium("air", 1.0)
        black = self._material("black")
        height, half = bench.crystal_height_mm, bench.crystal_width_mm / 2.0
        entrance = -bench.gap_mm
        back = entrance - bench.window_thickness_mm
        half_window = bench.window_width_mm / 2.0
        floor = back - _DETECTOR_THICKNESS_MM

        reach = 1.0 + 2.0 * max(half_window, height, -floor)
        cube = self._keep(g4.G4Box("world", reach, reach, reach))
        world = self._keep(g4.G4LogicalVolume(cube, air, "world"))
        placed = self._keep(
            g4.G4PVPlacement(None, g4.G4ThreeVector(), world, "world", None, False, 0)
        )
        crystal = self._medium(
            CRYSTAL, bench.n_crystal, bench.alpha_abs_per_cm, bench.alpha_scat_per_cm
        )
        gap = self._medium(
            "gap", bench.n_gap, bench.gap_absorption_per_cm if bench.is_filled else 0.0
        )
        glass = self._medium("window", bench.n_window, bench.window_absorption_per_cm)
        self._counted[CRYSTAL] = self._slab(CRYSTAL, crystal, half, 0.0, height, world)
        self._slab("gap", gap, half, entrance, 0.0, world)
        window = self._slab("window", glass, half_window, back, entrance, world)
        detector = self._slab(DETECTOR, black, half_window, floor, back, world)
        self._blacken(detector)
        self._counted[DETECTOR] = detector
        if bench.aperture_radius_mm < half_window * math.sqrt(2.0):
            self._counted[MASK] = self._add_mask(window, black, half_window)
        return placed

    def ConstructSDandField(self):
        for name, volume in self._counted.items():
            counter = self._keep(g4.G4MultiFunctionalDetector(name))
            g4.G4SDManager.GetSDMpointer().AddNewDetector(counter)
            counter.RegisterPrimitive(self._keep(g4.G4PSEnergyDeposit(LIGHT)))
            self.SetSensitiveDetector(volume, counter)

    def _keep(self, made):
        self._kept.append(made)
        return made

    def _material(self, name: str):
        """A material whose chemistry does not matter to light."""
        return self._keep(g4.G4Material(name, 1.0, 1.01 * g4.g / g4.mole, 1.0 * g4.g / g4.cm3))

    def _medium(self, name: str, index: float, absorption_per_cm=0.0, scattering_per_cm=0.0):
        """A material of a refractive index, with absorption and isotropic scattering."""
        values = {"RINDEX": index}
        if absorption_per_cm > 0.0:
            values["ABSLENGTH"] = g4.cm / absorption_per_cm
        if scattering_per_cm > 0.0:
            values["MIEHG"] = g4.cm / scattering_per_cm
        properties = self._properties(values)
        # Henyey and Greenstein's law with g = 0 is isotropic; Rayleigh's would not be.
        properties.AddConstProperty("MIEHG_FORWARD", 0.0)
        properties.AddConstProperty("MIEHG_BACKWARD", 0.0)
        properties.AddConstProperty("MIEHG_FORWARD_RATIO", 1.0)
        material = self._material(name)
        material.SetMaterialPropertiesTable(properties)
        return material

    def _properties(self, values: dict[str, float]):
        """A table of properties that do not depend on the photon's energy."""
        table = self._keep(g4.G4MaterialPropertiesTable())
        for name, value in values.items():
            table.AddProperty(name, _ENERGIES, g4.G4doubleVector([value, value]))
        return table

    def _slab(self, name: str, material, half_width_mm, bottom_mm, top_mm, mother):
        """Place a box that is centred on x = y = 0."""
        half_height_mm = (top_mm - bottom_mm) / 2.0
        solid = self._keep(g4.G4Box(name, half_width_mm, half_width_mm, half_height_mm))
        volume = self._keep(g4.G4LogicalVolume(solid, material, name))
        centre = g4.G4ThreeVector(0.0, 0.0, (bottom_mm + top_mm) / 2.0)
        self._keep(g4.G4PVPlacement(None, centre, volume, name, mother, False, 0))
        return volume

    def _add_mask(self, window, black, half_window_mm: float):
        """Let the mask into the window, flush with its entrance face."""
        plate = self._keep(
            g4.G4Box("mask plate", half_window_mm, half_window_mm, MASK_THICKNESS_MM / 2.0)
        )
        hole = self._keep(
            g4.G4Tubs(
                "hole", 0.0, self._bench.aperture_radius_mm, MASK_THICKNESS_MM, 0.0, 2.0 * math.pi
            )
        )
        solid = self._keep(g4.G4SubtractionSolid(MASK, plate, hole))
        mask = self._keep(g4.G4LogicalVolume(solid, black, MASK))
        depth = (self._bench.window_thickness_mm - MASK_THICKNESS_MM) / 2.0
        place = g4.G4ThreeVector(0.0, 0.0, depth)
        self._keep(g4.G4PVPlacement(None, place, mask, MASK, window, False, 0))
        self._blacken(mask)
        return mask

    def _blacken(self, volume) -> None:
        """Let the surface of a volume absorb, and count, whatever meets it."""
        surface = self._keep(
            g4.G4OpticalSurface("black", g4.glisur, g4.polished, g4.dielectric_metal)
        )
        surface.SetMaterialPropertiesTable(
            self._properties({"REFLECTIVITY": 0.0, "EFFICIENCY": 1.0})
        )
        self._keep(g4.G4LogicalSkinSurface(volume.GetName(), volume, surface))
