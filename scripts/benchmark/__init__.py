"""How fast is it? Our transport and others on the same bench, in one run.

    python scripts/benchmark             # some minutes, on an idle machine
    python scripts/benchmark --quick     # does it work? a minute; its numbers are rough

The others are a scalar tracer in C++, where there is a compiler for it, the independent tracer
and, if it is installed, Geant4. The first part compares how fast photons are followed, and how
fast a precision of eta is reached. The second compares a table of eta from reweighted photons with
one simulation per point. All use every processor core. Start-up and the compilation of kernels are
timed apart.
"""
