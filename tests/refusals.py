"""The one line in which something is refused."""

import time

import pytest

from mcrim_mitsuba.core.errors import InputError

#: Of processor time, on a machine that is busy: what took minutes before stays far below.
PATIENCE_S = 20.0


def refusal(reader, *arguments, **options) -> str:
    """What is said: one line that steers no terminal, in good time, with a mend."""
    start = time.process_time()
    with pytest.raises(InputError) as caught:
        reader(*arguments, **options)
    said = str(caught.value)
    assert said.isprintable() and len(said) < 4000 and caught.value.mend
    assert time.process_time() - start < PATIENCE_S
    return said
