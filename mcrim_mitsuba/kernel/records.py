"""Photon records of one launch, as the fit takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.fit.proposals import Proposals
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.kernel import transport
from mcrim_mitsuba.kernel.collection import choose_path, refuse_leaks
from mcrim_mitsuba.kernel.lane_plan import BATCHES, plan_lanes
from mcrim_mitsuba.kernel.simulation import Simulation
from mcrim_mitsuba.kernel.tally import FateTally
from mcrim_mitsuba.units import MM_PER_CM

#: Light that may be cut off at the depth limit: less than any error that is asked for.
MOST_TRUNCATED = 1e-5
#: Photons that may be cut off in any case: in a short run they are within the error.
FEW_TRUNCATED = 3.0


class Recorder:
    """Simulates a configuration's photon records, launch by launch.

    Parameters
    ----------
    simulation : Simulation
        Its own coefficients do not matter.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._path = choose_path(simulation.model, simulation.polarization)
        self._tally = FateTally()

    def record(
        self,
        proposals: Proposals,
        photons: int,
        *,
        seed: int,
        number: int,
        columns: Sequence[str] = (),
    ) -> PhotonRecords:
        """Histories of the photons of one launch that are detected.

        Parameters
        ----------
        proposals : Proposals
            With shares in units of 1 / `lane_plan.UNITS`.
        photons : int
            A multiple of `lane_plan.LANES`.
        seed, number : int
            Of the run and of the launch.
        columns : sequence of str
            What ``further`` of the records holds, see `record_store.RecordStore`; where the
            crystal scatters unevenly, it always holds ``scattering_path_cm``.

        Raises
        ------
        InputError
            If the scene leaks, keeps more light than records may miss, or does not have a column.
        """
        simulation = self._simulation
        # Scattered light gets out in the end; what is cut off would be missing at every alpha.
        max_depth = simulation.integrator.depth_limit(scatters=True)
        found = transport.launch(
            self._path,
            simulation.crystal,
            plan_lanes(photons, proposals.units),
            seed=seed,
            number=number,
            max_depth=max_depth,
            alpha_scat_per_mm=np.array(proposals.alpha_scat_per_cm) / MM_PER_CM,
            alpha_abs_per_mm=proposals.alpha_abs_per_cm / MM_PER_CM,
            keep_records=True,
            columns=columns,
        )
        self._tally.add(found.photons_per_batch, found.weights)
        refuse_leaks(self._tally)
        truncated = self._tally.fraction("truncated")
        if truncated > max(MOST_TRUNCATED, FEW_TRUNCATED / self._tally.photons):
            raise InputError(
                f"{100 * truncated:.2g} % of the light was still under way after "
                f"{max_depth:,} flights",
                "raise max_depth of the integrator, or ask for more absorption",
                path=simulation.file.path,
            )
        assert found.records is not None  # asked for
        further = dict(found.records)
        core = {name: further.pop(name) for name in ("k", "path_cm", "w", "batch")}
        return PhotonRecords(
            **core,
            batches=BATCHES,
            photons_per_proposal=np.array(proposals.units) * (photons // sum(proposals.units)),
            alpha_scat_proposals_per_cm=np.array(proposals.alpha_scat_per_cm),
            alpha_abs_proposal_per_cm=proposals.alpha_abs_per_cm,
            further=further,
        )
