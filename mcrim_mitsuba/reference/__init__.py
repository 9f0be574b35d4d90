"""Independent answers to compare with; none shares code with the engine that it checks.

`tracer.trace(Bench(), photons, seed)` is an analog photon tracer in NumPy with analytic geometry
and physics of its own, `geant4.trace_geant4` the same bench in Geant4, in a process of its own
(``geant4_process``), and `crosscheck.crosscheck` puts Mitsuba beside the tracer, fate by fate.
`polished_box.solve_box(Bench(), scattering, absorption)` needs no photons: eta of a polished box,
its derivatives and its own estimate of its error, in milliseconds.
`scene_bench.bench_of(simulation)` gives the bench that a loaded scene is, and `noise_free` answers
for scenes what the method ``modes`` is asked for.
"""
