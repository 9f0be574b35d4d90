"""A user's script: every public function, and three fields of what it gives.

`test_types.py` has mypy check it as strictly as it can; it is not run.
"""

from pathlib import Path

import mcrim_mitsuba as mcrim

run = mcrim.Run(photons=20_000, seed=1, threads=2)
scene = mcrim.read_scene("scenes/camoo4.xml", {"n_gap": 1.46})
campaign = mcrim.read_campaign("scenes/camoo4_campaign.toml")

light = mcrim.simulate(scene, run=run, gap_mm=0.05)
print(light.eta, light.budget["detected"], light.photons_per_second)
table = mcrim.table("scenes/camoo4.xml", n_gap=[1.0, 1.46], photons=2e4, precision=0.01)
print(table.eta.shape, table.rows[0]["eta"], table.to_xarray().eta.sizes)
eta_map = mcrim.eta_map(scene, cells=(4, 4, 4), depth_mm=0.5, run=run)
print(eta_map.eta_sigma, eta_map.gamma_spreads[0].fwhm, eta_map.centres_mm)
spectrum = mcrim.eta_spectrum(scene, Path("light.csv"), seed=3)
print(spectrum.eta_detected, spectrum.light.mean_nm, spectrum.wavelengths[0])
times = mcrim.arrival_times(scene, decay_ns=10.0, detected=500, threads=1)
print(times.mean_ps, times.first[0].born, times.parts[0].group_index)
checked = mcrim.check(scene, variant="llvm_ad_rgb")
print(checked.ok, [problem.mend for problem in checked.problems], checked.words)
crosscheck = mcrim.crosscheck(scene, photons="1e5")
print(crosscheck.agrees, crosscheck.rows[0].z, crosscheck.photons["numpy"])
picture = mcrim.render(scene, samples=4)
print(picture.parts, picture.pixels.shape, picture.scene_hash)
ground = mcrim.add("ground", scene, ground_slope=0.1)
print(ground.path, ground.parameters["gap_mm"], ground.content_hash)

raw = mcrim.reduce("scenes/camoo4_raw.toml")
print(raw.readings["air"].combined.mean, raw.kinds, raw.notes)
fit = mcrim.calibrate(campaign, photons=1_000_000)
print(float(fit.light_yield_ph_per_keV), fit.light_yield_ph_per_keV.sigma, fit.rows[0].pull)
print(fit.alpha_scat_per_cm, fit.parameters["alpha_scat_per_cm"].value, fit.profiles[0].interval_95)
comparison = mcrim.compare(campaign, seed=1)
print(comparison.suspects[0].words, comparison.left_out_error, comparison.scale.value)
hypotheses = mcrim.compare(campaign, "other.toml", run=run)
print(hypotheses.verdict, hypotheses.leading, hypotheses.hypotheses[0].probability)
diagnosis = mcrim.diagnose(campaign, without="background", only=["nonlinearity"])
print(diagnosis.verdict, diagnosis.candidates[0].delta_chi2, diagnosis.baseline.chi2)
repaired = mcrim.repair(campaign, effect="gap_bubble", on_step=print)
print(repaired.effects, repaired.light_yield_ph_per_keV.value, repaired.repair[0].rms_pull)
budget = mcrim.budget(campaign, material="CaMoO4", wavelength_nm=540)
print(budget.main, budget.totals["scale"].sigma, budget.notes)
plan = mcrim.plan(campaign, 0.1, n_gap=[1.0, 1.46], events=1e4)
print(plan.cheapest and plan.cheapest.hours, plan.plans[0].mountings, plan.wanted)
report = mcrim.report(campaign, "page.html", effects=["gap_bubble"])
print(report.path, report.chi2, report.sections.headline)

for result in (light, table, fit, diagnosis):
    print(result, result.to_json(), result.to_dataframe().columns)
    result.plot().savefig("figure.png")
    print(result.draw("figures.png"), result.pictures, result.document["kind"])
