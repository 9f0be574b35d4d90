"""The process in which Geant4 runs: ``python scripts/geant4_process.py JOB``.

It writes one JSON object a line to standard output: ``{"done": photons}`` while it goes on, and
the result last. What Geant4 itself prints goes to standard error."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time

import geant4_pybind as g4
from geant4 import CRYSTAL, DETECTOR, FATES, MASK

from mcrim_mitsuba.efficiency.bench import Bench

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
        placed = self._place("world", world, 0.0, None)
        crystal = self._medium(
            CRYSTAL, bench.n_crystal, bench.alpha_abs_per_cm, bench.alpha_scat_per_cm
        )
        of_gap = bench.gap_absorption_per_cm if bench.is_filled else 0.0
        gap = self._medium("gap", bench.n_gap, of_gap)
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
        solid = self._keep(self._solid(name, half_width_mm, (top_mm - bottom_mm) / 2.0))
        volume = self._keep(g4.G4LogicalVolume(solid, material, name))
        self._place(name, volume, (bottom_mm + top_mm) / 2.0, mother)
        return volume

    def _solid(self, name: str, half_width_mm: float, half_height_mm: float):
        """What is as wide along x as along y."""
        return g4.G4Box(name, half_width_mm, half_width_mm, half_height_mm)

    def _place(self, name: str, volume, z_mm: float, mother):
        """Put the centre of a volume on the axis of its mother."""
        centre = g4.G4ThreeVector(0.0, 0.0, z_mm)
        return self._keep(g4.G4PVPlacement(None, centre, volume, name, mother, False, 0))

    def _add_mask(self, window, black, half_window_mm: float):
        """Let the mask into the window, flush with its entrance face."""
        radius, thickness = self._bench.aperture_radius_mm, MASK_THICKNESS_MM
        plate = self._keep(g4.G4Box("mask plate", half_window_mm, half_window_mm, thickness / 2.0))
        hole = self._keep(g4.G4Tubs("hole", 0.0, radius, thickness, 0.0, 2.0 * math.pi))
        solid = self._keep(g4.G4SubtractionSolid(MASK, plate, hole))
        mask = self._keep(g4.G4LogicalVolume(solid, black, MASK))
        depth = (self._bench.window_thickness_mm - MASK_THICKNESS_MM) / 2.0
        self._place(MASK, mask, depth, window)
        self._blacken(mask)
        return mask

    def _blacken(self, volume) -> None:
        """Let the surface of a volume absorb, and count, whatever meets it."""
        black = g4.G4OpticalSurface("black", g4.glisur, g4.polished, g4.dielectric_metal)
        surface = self._keep(black)
        absorbs = self._properties({"REFLECTIVITY": 0.0, "EFFICIENCY": 1.0})
        surface.SetMaterialPropertiesTable(absorbs)
        self._keep(g4.G4LogicalSkinSurface(volume.GetName(), volume, surface))


#: Photons of one event: many, because every event calls Python at its start and its end.
PHOTONS_PER_EVENT = 5000
#: Seconds between two reports of the progress.
REPORT_SECONDS = 0.5
_uniform = g4.G4UniformRand


class Geant4Source(g4.G4VUserPrimaryGeneratorAction):
    """Photons born uniformly in the crystal, isotropic; Geant4 polarises them at random."""

    def __init__(self, bench: Bench, run: Geant4Run) -> None:
        super().__init__()
        self._run = run
        self._source = g4.G4GeneralParticleSource()
        one = self._source.GetCurrentSource()
        one.SetParticleDefinition(g4.G4OpticalPhoton.Definition())
        one.GetEneDist().SetMonoEnergy(PHOTON_ENERGY)
        one.GetAngDist().SetAngDistType("iso")
        where = one.GetPosDist()
        where.SetPosDisType("Volume")
        where.SetPosDisShape("Para")
        half_width, half_height = bench.crystal_width_mm / 2.0, bench.crystal_height_mm / 2.0
        where.SetCentreCoords(g4.G4ThreeVector(0.0, 0.0, half_height))
        where.SetHalfX(half_width)
        where.SetHalfY(half_width)
        where.SetHalfZ(half_height)

    def GeneratePrimaries(self, event):
        # A source that shoots many particles at once shoots them from one point.
        shoot = self._source.GeneratePrimaryVertex
        for _ in range(self._run.photons_of(event.GetEventID())):
            shoot(event)


class Counter(g4.G4UserEventAction):
    """Counts the photons of every event that end in a counted volume, by their energy."""

    def __init__(self, run: Geant4Run) -> None:
        super().__init__()
        self._run = run
        self._collections: dict[str, int] = {}

    def EndOfEventAction(self, event):
        if not self._collections:
            manager = g4.G4SDManager.GetSDMpointer()
            found = {name: manager.GetCollectionID(f"{name}/{LIGHT}") for name in FATES}
            # a bench without a mask has no collection of its
            self._collections = {name: number for name, number in found.items() if number >= 0}
        hits = event.GetHCofThisEvent()
        ended = {
            name: round(sum(energy for _, energy in hits.GetHC(number)) / PHOTON_ENERGY)
            for name, number in self._collections.items()
        }
        self._run.count(event.GetEventID(), ended)


class Depolarizer(g4.G4UserSteppingAction):
    """Turns the polarisation by a right angle after every step, or not, as a coin falls.

    Geant4 follows linear polarisation. The coin makes of every face's reflection the mean of that
    of s and p, whatever came before: that of unpolarised light.
    """

    def UserSteppingAction(self, step):
        if _uniform() < 0.5:
            track = step.GetTrack()
            along = track.GetMomentumDirection()
            track.SetPolarization(along.cross(track.GetPolarization()))


class Actions(g4.G4VUserActionInitialization):
    """Gives every thread its source and its counter."""

    def __init__(self, bench: Bench, run: Geant4Run, depolarize: bool) -> None:
        super().__init__()
        self._bench, self._run, self._depolarize = bench, run, depolarize

    def Build(self):
        self.SetUserAction(Geant4Source(self._bench, self._run))
        self.SetUserAction(Counter(self._run))
        if self._depolarize:
            self.SetUserAction(Depolarizer())


class OpticalPhysics(g4.G4VModularPhysicsList):
    """Light and nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.SetVerboseLevel(0)
        self.RegisterPhysics(g4.G4OpticalPhysics())


class Geant4Run:
    """Geant4, initialised for a bench; one per process, which calls ``report(done=photons)``."""

    def __init__(
        self, bench: Bench, engine_seed: int, threads: int, depolarize: bool, report
    ) -> None:
        self._report, self._reported = report, time.monotonic()
        self._lock = threading.Lock()
        kind = g4.G4RunManagerType.MT if threads > 1 else g4.G4RunManagerType.Serial
        self._manager = g4.G4RunManagerFactory.CreateRunManager(kind)
        if threads > 1:
            self._manager.SetNumberOfThreads(threads)
        g4.G4Random.setTheSeed(engine_seed)
        self._manager.SetUserInitialization(BenchConstruction(bench))
        self._manager.SetUserInitialization(OpticalPhysics())
        self._manager.SetUserInitialization(Actions(bench, self, depolarize))
        # What the bench has not got would only cost Geant4 time at every step.
        for absent in ("Cerenkov", "Scintillation", "OpRayleigh", "OpWLS", "OpWLS2"):
            _command(f"/process/optical/processActivation {absent} false")
        _command("/process/optical/boundary/setInvokeSD true")
        _command("/run/verbose 0")
        # As a command, it lets go of Python's lock, for which the threads wait.
        _command("/run/initialize")
        # Geant4 starts its threads at the first run.
        self.beam_on(threads)

    def beam_on(self, photons: int) -> dict[str, int]:
        """Emit photons, wait for the last of them, and say how many ended in which volume."""
        self._photons, self._done, self._ended = photons, 0, dict.fromkeys(FATES, 0)
        self._manager.BeamOn(-(-photons // PHOTONS_PER_EVENT))
        return self._ended

    def photons_of(self, event: int) -> int:
        """Photons that an event emits; the last one may emit fewer."""
        return min(PHOTONS_PER_EVENT, self._photons - event * PHOTONS_PER_EVENT)

    def count(self, event: int, ended: dict[str, int]) -> None:
        """Note where an event's photons ended."""
        with self._lock:
            for name, photons in ended.items():
                self._ended[name] += photons
            self._done += self.photons_of(event)
        now = time.monotonic()
        if now - self._reported > REPORT_SECONDS:
            self._reported = now
            self._report(done=self._done)


def _command(text: str) -> None:
    g4.G4UImanager.GetUIpointer().ApplyCommand(text)


def main() -> None:
    """Do the job of the command line."""
    job = json.loads(sys.argv[1])
    reports = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def report(**found) -> None:
        print(json.dumps(found), file=reports, flush=True)

    bench = Bench(**job["bench"])
    run = Geant4Run(bench, job["engine_seed"], job["threads"], job["depolarize"], report)
    started = time.perf_counter()
    ended = run.beam_on(job["photons"])
    seconds = time.perf_counter() - started
    number = g4.G4VERSION_NUMBER
    version = f"{number // 100}.{number // 10 % 10}.{number % 10}"
    report(ended=ended, seconds=seconds, version=version)
    # Geant4 and Python would free the same objects at exit.
    os._exit(0)


if __name__ == "__main__":
    main()
