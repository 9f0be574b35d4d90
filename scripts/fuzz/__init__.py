"""Fuzzes every reader of what users give: inputs that are random, but steered by coverage.

    pip install -e '.[fuzz]'
    python scripts/fuzz                                  # all readers, 600 s each
    python scripts/fuzz --target scene --seconds 60
    python scripts/fuzz --target scene --again fuzz/scene-1f0c2a.input

Atheris (libFuzzer) changes the repository's own files, keeps what reaches new code, and counts.
A finding is an input at which a reader

- raises anything but an `InputError` (or a command ends otherwise than done, or refused in one
  line on standard error);
- overflows in silence (NumPy's warnings);
- takes more than 5 s of processor time, or 300 s by the clock;
- takes more than 2 GB of memory.

Each is told once per place in the code, saved in the folder, and makes the exit status 1. Inputs
that reached new code stay in the folder too: the next run begins with them.
"""
