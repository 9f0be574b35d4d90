"""Eta over wavelengths by weights, against simulations of each wavelength.

Random tests have fixed seeds; thresholds are stated where they stand.
"""

import numpy as np
import pytest
from places import SCENES

import mcrim_mitsuba
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_spectrum import eta_over, read_light
from mcrim_mitsuba.optics.materials import material
from mcrim_mitsuba.scene.scene_file import read_scene

BENCH = SCENES / "camoo4.xml"
RAW = SCENES / "camoo4_raw"
#: Of the largest of six |z|: a right program fails in one run in 1,000.
LARGEST_Z = 3.8


def written(folder, header, *columns):
    file = folder / "light.csv"
    rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
    file.write_text("\n".join([header, *rows]) + "\n")
    return file


@pytest.fixture
def tenfold(tmp_path):
    """A band over which both coefficients change tenfold, near an absorption edge."""
    at = np.arange(400.0, 701.0, 20.0)
    emission = np.exp(-(((at - 530.0) / 90.0) ** 2))
    absorption = 0.02 * 10.0 ** ((700.0 - at) / 300.0)
    scattering = 0.2 * 10.0 ** ((700.0 - at) / 300.0)
    header = "wavelength_nm,emission,alpha_abs_per_cm,alpha_scat_per_cm"
    return written(tmp_path, header, at, emission, absorption, scattering)


def test_weights_give_what_simulations_of_each_wavelength_give(tenfold):
    file = read_scene(BENCH, {})
    light = read_light(tenfold, file)
    precision = 0.002
    found = eta_over(file, light, run=Run(precision=precision, seed=1))
    at = [int(np.abs(light.wavelength_nm - nm).argmin()) for nm in range(400, 701, 60)]
    alone = [
        mcrim_mitsuba.simulate(file, precision=precision, seed=10 + number, **light.at(float(nm)))
        for number, nm in enumerate(light.wavelength_nm[at])
    ]
    z = [
        (found.eta[i] - one.eta) / np.hypot(found.eta_sigma[i], one.eta_sigma)
        for i, one in zip(at, alone, strict=True)
    ]
    assert np.abs(z).max() < LARGEST_Z, z
    assert (found.eta_sigma[at] < 1.05 * precision * found.eta[at]).all()
    # for six wavelengths; those of the whole spectrum, ten times as many, come with them
    assert len(light.wavelength_nm) == 61
    assert 2.0 * found.photons < sum(one.photons for one in alone)


def test_between_nodes_the_index_follows_the_dispersion():
    """At wavelengths that are no nodes, both indices as the materials have them."""
    named = {"n_crystal": "CaMoO4@540nm", "n_window": "BK7@540nm"}
    file = read_scene(BENCH, named)
    light = read_light(RAW / "emission.csv", file, RAW / "quantum_efficiency.csv")
    assert set(light.parameters) == set(named)
    found = eta_over(file, light, run=Run(photons=1_000_000, seed=2))
    assert len(found.nodes_nm) == 4
    z = []
    for number, nm in enumerate((440.0, 520.0, 660.0)):
        indices = {
            "n_crystal": float(material("CaMoO4").held_index(nm)),
            "n_window": float(material("BK7").index(nm)),
        }
        one = mcrim_mitsuba.simulate(BENCH, photons=2_000_000, seed=20 + number, **indices)
        i = int(np.abs(light.wavelength_nm - nm).argmin())
        assert light.wavelength_nm[i] == pytest.approx(nm)
        z.append((found.eta[i] - one.eta) / np.hypot(found.eta_sigma[i], one.eta_sigma))
    # the largest of three: one right run in 1,000 fails
    assert np.abs(z).max() < 3.6, z
    assert found.interpolation_error < 0.004


def test_means_are_integrals_over_the_light(tenfold, tmp_path):
    file = read_scene(BENCH, {})
    table = np.genfromtxt(tenfold, delimiter=",", names=True)
    nm, efficiency = table["wavelength_nm"], np.linspace(0.3, 0.05, len(table))
    header = "wavelength_nm,emission,alpha_abs_per_cm,alpha_scat_per_cm,efficiency"
    columns = [table[name] for name in table.dtype.names]
    light = read_light(written(tmp_path, header, *columns, efficiency), file)
    found = eta_over(file, light, run=Run(photons=500_000, seed=3))
    at, emission = light.wavelength_nm, light.emission
    seen = emission * np.interp(at, nm, efficiency)

    def mean(of, over):
        return np.trapezoid(of * over, at) / np.trapezoid(over, at)

    assert found.eta_emitted == pytest.approx(mean(found.eta, emission), rel=1e-6)
    assert found.eta_detected == pytest.approx(mean(found.eta, seen), rel=1e-6)
    assert found.efficiency_emitted == pytest.approx(mean(light.efficiency, emission), rel=1e-6)
    product = mean(found.eta * light.efficiency, emission)
    assert found.efficiency_arriving * found.eta_emitted == pytest.approx(product, rel=1e-6)
    off = found.eta_at_mean * found.efficiency_emitted / product - 1.0
    assert found.one_wavelength_off == pytest.approx(off, rel=1e-6)
    assert np.trapezoid(found.detected_part, at) == pytest.approx(1.0)
    # errors of means over common photons are no smaller than those of wavelengths, and no larger
    assert found.eta_emitted_sigma < 1.1 * float(found.eta_sigma.max())
    made = found.to_xarray()
    assert made.eta.dims == ("wavelength_nm",) and made.attrs["seed"] == 3


@pytest.mark.parametrize(
    "text, said",
    [
        ("wavelength_nm,emission,alpha_abs\n400,1,2\n500,1,2\n", "no parameter 'alpha_abs'"),
        ("wavelength_nm,emission,efficiency\n400,1,0.2\n500,1,1.2\n", "efficiency = 1.2 is out"),
        ("wavelength_nm,emission,alpha_abs_per_cm\n400,1,1\n400,1,2\n", "400 nm stands there"),
        ("wavelength_nm,emission\n400,0\n500,0\n600,0\n", "no area"),
        ("wavelength_nm,emission,alpha_scat_per_cm\n400,1,-1\n500,1,2\n", "-1 is out of range"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(tmp_path, text, said):
    file = tmp_path / "light.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=said) as refused:
        read_light(file, read_scene(BENCH, {}))
    assert "light.csv" in str(refused.value)


def test_the_command_shows_and_draws_it(tenfold, mcrim, here):
    said = mcrim(
        "simulate", str(BENCH), "--photons", "300000", "--spectrum", str(tenfold),
        "--figure", "picture.png", "--json", "light.json",
    )  # fmt: skip
    assert said.status == 0 and "what is detected would be off by" in said.out
    assert (here / "picture_spectrum.png").stat().st_size > 20_000
    assert "one_wavelength_off" in (here / "light.json").read_text()
    said = mcrim("simulate", str(BENCH), "--quantum-efficiency", "x.csv")
    assert said.status == 2 and "give --spectrum" in said.err
