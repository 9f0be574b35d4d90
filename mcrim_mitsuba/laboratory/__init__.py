"""Raw data to numbers: histograms and their peaks, efficiencies, light yields with their errors."""
