"""Mitsuba against closed forms, the independent tracer and Geant4, on more than a hundred benches.

    python scripts/validate                     # some 20 minutes on two idle cores
    python scripts/validate --precision 0.5%    # a few minutes; rougher

Writes docs/validation.md, .png and .csv: a verdict at a stated false-alarm level, z-scores of every
bench and program, and what they rest on. Exit status 1 if a program disagrees. Work that is done is
kept in a file of units: an interrupted run goes on, a finer precision adds to what is there, and
only what new code could have changed is done again. For a timetable (cron, Mondays at 3):

    0 3 * * 1 cd mcrim_mitsuba && .venv/bin/python scripts/validate --log validation.log
"""
