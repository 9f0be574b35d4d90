"""What every room stands on; it knows nothing of light, scenes or campaigns.

Others take: refusals with their mend (`errors`), files read with care and written whole (`files`),
numbers as people type them and what a parameter's value may be (`numbers`), numbers as people read
them (`rounding`), results as JSON (`files`), TOML whose entries know their lines
(`toml_document`), tables of numbers as instruments write them (`data_table`; `table_text` is its
own), how simulations are done (`run`), one small minimiser (`descent`).
"""
