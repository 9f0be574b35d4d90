"""The article, number by number: V. Alenkov et al., JINST 8 (2013) P06002, arXiv:1303.5952."""
