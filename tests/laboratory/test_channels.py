"""Channels of a digitiser are never taken for photoelectrons."""

import numpy as np
import pytest
from refusals import refusal
from scipy.stats import norm

from mcrim_mitsuba.laboratory.histogram import read_histogram

BINS = np.arange(1024)
MEND = "give a calibration: [calibration] with single_photoelectron"


def spectrum(seed: int, pedestal: float = 60.0, width: float = 3.0) -> np.ndarray:
    """A pedestal and a peak of 500 channels."""
    shape = 20_000 * norm.pdf(BINS, pedestal, width) + 50_000 * norm.pdf(BINS, 500, 40)
    return np.random.default_rng(seed).poisson(shape + 2.0)


def rows(*columns: np.ndarray) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


@pytest.mark.parametrize("header", ["channel,counts", "ADC,N", "bin,counts", "Ch.,entries", ""])
def test_channels_are_no_photoelectrons(tmp_path, header):
    path = tmp_path / "h.csv"
    path.write_text(f"{header}\n" * bool(header) + rows(BINS, spectrum(1)))
    assert MEND in refusal(read_histogram, path)
    assert read_histogram(path, channels=True).counts.sum() == spectrum(1).sum()


@pytest.mark.parametrize(
    "header", ["energy (keV),counts", "E_keV,N", "bin low edge,counts", "pe_left_edge,counts"]
)
def test_energies_and_edges_of_bins_are_no_photoelectrons(tmp_path, header):
    """Peaks of all couplings lie at one energy; an edge is half a bin below the centre."""
    path = tmp_path / "h.csv"
    path.write_text(f"{header}\n" + rows(BINS, spectrum(2, 60.0, 8.5)))
    assert "has energies or edges of bins" in refusal(read_histogram, path)


def test_photoelectrons_stay_what_they_are(tmp_path):
    path = tmp_path / "h.csv"
    for header in ("photoelectrons at 662 keV,counts", "n_pe,N", "photons_per_event,events"):
        path.write_text(f"{header}\n" + rows(BINS, spectrum(2)))
        assert len(read_histogram(path).photons) == 1024
        if header != "n_pe,N":
            assert "is calibrated already" in refusal(read_histogram, path, channels=True)
    # a wide first peak, as counted photons have, needs no name
    path.write_text(rows(BINS, spectrum(2, 60.0, 8.5)))
    assert len(read_histogram(path).photons) == 1024


def test_counts_alone_and_swapped_columns_are_said(tmp_path):
    path, counts = tmp_path / "h.csv", spectrum(3)
    path.write_text(rows(counts))
    assert "may be counts by channel, or photoelectrons by event" in refusal(read_histogram, path)
    path.write_text("counts\n" + rows(counts))
    assert MEND in refusal(read_histogram, path)
    assert np.array_equal(read_histogram(path, channels=True).counts, counts)
    for header in ("", "counts,channel\n"):
        path.write_text(header + rows(counts, BINS))
        assert "the columns are swapped" in refusal(read_histogram, path)
    path.write_text("counts,channel\n" + rows(BINS, counts))
    assert "the names are swapped: counts, channel" in refusal(read_histogram, path)


def test_lists_of_charges_are_no_photoelectrons(tmp_path):
    path, random = tmp_path / "events.txt", np.random.default_rng(5)
    charges = np.concatenate([random.normal(120, 3, 5000), random.normal(2000, 150, 20_000)])
    rows_of_events = rows(random.permutation(charges).astype(int))
    for head in ("", "adc\n"):
        path.write_text(head + rows_of_events)
        assert MEND in refusal(read_histogram, path)
    path.write_text(f"photons\n{rows_of_events}")
    assert read_histogram(path).counts.sum() == 25_000


@pytest.mark.parametrize("head", ["", "x\n"])
@pytest.mark.parametrize(("mean", "width", "digits"), [(30, 7, 4), (2000, 150, 0), (14.3, 4, 2)])
def test_lists_of_events_say_what_they_hold(tmp_path, head, mean, width, digits):
    path, events = tmp_path / "q.txt", np.random.default_rng(6).normal(mean, width, 5000)
    numbers = "".join(f"{event:.{digits}f}\n" for event in events)
    path.write_text(head + numbers)
    assert "photoelectrons, charges or channels; name it" in refusal(read_histogram, path)
    for named in ("charge", "Q (pC)"):
        path.write_text(f"{named}\n{numbers}")
        assert read_histogram(path).counts.sum() == 5000
