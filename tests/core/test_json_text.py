"""Results as JSON."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mcrim_mitsuba.core.files import json_text, plain


@dataclass(frozen=True)
class Result:
    path: Path
    values: tuple
    by_index: dict


def test_what_results_are_made_of_becomes_plain():
    result = Result(Path("a/b.xml"), (np.float32(0.5), np.int64(3), True), {1.5: np.arange(2.0)})
    expected = {"path": "a/b.xml", "values": [0.5, 3, True], "by_index": {"1.5": [0.0, 1.0]}}
    assert plain(result) == expected and type(plain(result)["values"][2]) is bool
    assert json.loads(json_text([result, None, "η"], indent=2)) == [expected, None, "η"]
    assert "η" in json_text("η") and "\n" not in json_text(result)


def test_no_number_that_json_lacks_is_written():
    assert plain([math.nan, -math.inf, np.float64("inf"), np.array([math.nan])]) == [
        None,
        None,
        None,
        [None],
    ]
    with pytest.raises(TypeError, match="a complex"):
        plain({"x": 1j})
