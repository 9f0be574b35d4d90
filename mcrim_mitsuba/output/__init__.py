"""Results as people see them: sentences, figures, pictures, the report, CSV, NetCDF, LaTeX."""
