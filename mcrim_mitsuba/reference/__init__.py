"""Independent answers to compare with; none shares code with the transport that it checks.

`tracer.trace(Bench(), photons, seed)` is an analog photon tracer in NumPy with analytic geometry
and physics of its own (`flight`, `geometry`, `interface`), which knows no other room than `core`
and the words of `efficiency.bench`. `crosscheck.crosscheck` puts Mitsuba beside it, fate by fate,
and beside the solver without photons where that knows the bench.
"""
