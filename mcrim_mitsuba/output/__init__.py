"""Every result described once, and shown: terminal, notebook, figure, report, picture, file.

`describe_scene`, `describe_campaign` and `describe_laboratory` say which tables and sentences a
result is shown by, `description` what such a description is and how it is printed; `documents`
makes what ``--json`` writes, `codec` reads it again and converts it (CSV, NetCDF, LaTeX).
`sentences` words what was found. Figures come with the numbers behind them (`figure_style.Drawing`)
from `fit_figures`, `diagnosis_figures`, `budget_figures`, `light_figures` and
`laboratory_figures`; `report` writes the page, `cross_section` and `photograph` draw a bench.
Whatever begins with ``report_``, and `photographer`, is the report's own.
"""
