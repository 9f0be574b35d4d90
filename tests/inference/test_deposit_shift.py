"""What it does to readings where gammas stop: a map that is a formula."""

import numpy as np
import pytest

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.lighting import EtaMap
from mcrim_mitsuba.inference.deposit_shift import places_of
from mcrim_mitsuba.output.codec import netcdf_bytes


def rising(folder, **parameters):
    """Eta that falls from 0.27 at the bottom to 0.23 at the top, in ten slices."""
    edges = np.linspace(-5, 5, 3), np.linspace(-5, 5, 3), np.linspace(0, 10, 11)
    eta = np.broadcast_to(np.linspace(0.27, 0.23, 10), (2, 2, 10)).copy()
    known = EtaMap(
        edges_mm=edges,
        eta=eta,
        eta_sigma=np.full(eta.shape, 0.001),
        volume=np.full(eta.shape, 1 / 40),
        photons=40_000,
        seed=0,
        parameters={"crystal_width_mm": 10.0} | parameters,
        scene_hash="0",
    )
    file = folder / "eta.nc"
    file.write_bytes(netcdf_bytes(known.to_xarray()))
    return file


def test_light_near_the_top_raises_the_light_yield(scenes, tmp_path):
    campaign = read_campaign(scenes / "camoo4_campaign.toml")
    # coefficients are fitted: those of the map may differ
    found = places_of(campaign, rising(tmp_path, n_gap=1.46, alpha_scat_per_cm=2.0), 2.0)
    assert found.readings == ("gel",)
    everywhere, top, side = found.shifts
    parts = -np.diff(np.exp(-np.arange(11) / 2.0))
    mean = (parts * np.linspace(0.23, 0.27, 10)).sum() / parts.sum()
    assert top.eta == pytest.approx(mean) and everywhere.eta == pytest.approx(0.25)
    assert top.eta_shift == pytest.approx(mean / 0.25 - 1)
    assert top.yield_shift == pytest.approx(0.25 / mean - 1)
    # eight cells' noise of 40, less what both have in common
    weights = parts / parts.sum() / mean - 0.1 / 0.25
    assert top.sigma == pytest.approx(mean / 0.25 * 0.001 * np.sqrt((weights**2).sum() / 4))
    assert side.eta_shift == pytest.approx(0.0, abs=1e-12)
    assert found.half_range == pytest.approx(0.5 * top.yield_shift)


def test_a_map_of_another_bench_is_refused(scenes, tmp_path):
    campaign = read_campaign(scenes / "camoo4_campaign.toml")
    with pytest.raises(InputError, match="another bench than any reading"):
        places_of(campaign, rising(tmp_path, n_gap=1.2), 1.0)
