"""The article, number by number: V. Alenkov et al., JINST 8 (2013) P06002, arXiv:1303.5952.

`reproduce` puts ours beside what is printed (`published`): what follows from its own numbers
(`arithmetic`), what was simulated (`simulated`, `efficiency_rows`, `yield_rows`), where it
contradicts itself (`inconsistencies`), and its `figures`.
"""
