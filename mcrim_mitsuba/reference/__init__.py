"""Independent answers to compare with; none shares code with the transport that it checks.

`tracer.trace(scene, photons, seed)` is an analog photon tracer that walks over faces, compiled by
numba: `scene_bench` and `scene_shapes` read these from the scene's text, `faces` makes tables of
them, `walk` follows one photon, `interface` has the physics. They know no other room than `core`
and `scene`. `crosscheck.crosscheck` puts Mitsuba beside it, fate by fate, and beside the solver
without photons where that knows the bench.
"""
