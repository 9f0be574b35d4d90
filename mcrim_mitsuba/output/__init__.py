"""Every result described once, and shown: terminal, notebook, figure, report, picture, file.

`public` has the functions, `scene_results` and `campaign_results` the types of what they give.
`registry` says of each type how it is described, drawn and written. `describe_scene`,
`describe_campaign` and `describe_laboratory` say which tables and sentences a result is shown by,
`description` what such a description is and how it is printed, `sentences` words it. `codec` reads
what ``--json`` wrote and converts it (CSV, NetCDF, LaTeX). Figures come with the numbers behind
them (`figure_style.Drawing`) from `fit_figures`, `diagnosis_figures`, `budget_figures`,
`light_figures` and `laboratory_figures`; `report` writes the page, `cross_section` and
`photograph` draw a bench. Whatever begins with ``report_`` is the report's own.
"""
