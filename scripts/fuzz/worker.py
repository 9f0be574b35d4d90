"""One process of `fuzz`: fuzzes one reader until its time is over, or until it hangs.

    python scripts/fuzz/worker.py READER SECONDS FOLDER

Nothing of the package is imported before Atheris can watch it, so that all coverage counts.
"""

from __future__ import annotations

import hashlib
import sys
import time
from pathlib import Path

#: Lines of standard error for `fuzz`.
READY, FOUND = "ready", "finding: "
#: Of processor time: other work on the machine must not make an input slow.
_SLOW_S, _HANGING_S = 5.0, 300
_MOST_MB = 2048
#: Inputs may be so many times as long as the longest sound one.
_LONGER = 1.5
#: One change of so many is libFuzzer's own, of bytes.
_BYTES_EVERY = 4


def main(name: str, seconds: int, folder: Path) -> None:
    """Fuzz; libFuzzer ends the process."""
    import atheris

    with atheris.instrument_imports(include=["mcrim_mitsuba", "tomllib", "tomlkit"]):
        from fuzz import targets
    from fuzz.mutation import mutate

    target = targets.TARGETS[name]
    known: set[str] = set()

    def one_input(data: bytes) -> None:
        start = time.process_time()
        error = targets.attempt(target, data)
        spent = time.process_time() - start
        place = None if error is None else targets.place_of(error)
        if spent > _SLOW_S:
            place = f"slow: {place or 'read or refused'}"
        if place is not None and place not in known:
            known.add(place)
            file = folder / f"{name}-{hashlib.sha256(place.encode()).hexdigest()[:12]}.input"
            file.write_bytes(data)
            words = " ".join(f"{place} ({spent:.1f} s): {file}".split())
            print(f"{FOUND}{words}", file=sys.stderr, flush=True)

    def changed(data: bytes, size: int, seed: int) -> bytes:
        if seed % _BYTES_EVERY == 0:
            return atheris.Mutate(data, size)
        return mutate(data, size, seed, target.words)

    corpus = folder / name
    largest = round(_LONGER * max(map(len, target.seeds)))
    for seed in target.seeds:
        (corpus / hashlib.sha256(seed).hexdigest()).write_bytes(seed)
    with targets.workplace():
        atheris.Setup(
            [
                sys.argv[0],
                str(corpus),
                f"-max_total_time={seconds}",
                f"-timeout={_HANGING_S}",
                f"-rss_limit_mb={_MOST_MB}",
                f"-max_len={largest}",
                "-len_control=0",
                "-report_slow_units=1000",
                f"-artifact_prefix={folder}/{name}-",
            ],
            one_input,
            custom_mutator=changed,
        )
        print(READY, file=sys.stderr, flush=True)
        atheris.Fuzz()


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
