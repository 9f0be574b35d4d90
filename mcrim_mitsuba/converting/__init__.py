"""Results of commands as CSV, NetCDF and LaTeX.

``read_results(files)`` gives a `ResultTable`; ``write_table(table, path)`` writes it in the format
of the path's suffix.
"""

from mcrim_mitsuba.converting.reading import read_results
from mcrim_mitsuba.converting.result_table import ResultTable
from mcrim_mitsuba.converting.writing import SUFFIXES, write_table

__all__ = ["SUFFIXES", "ResultTable", "read_results", "write_table"]
