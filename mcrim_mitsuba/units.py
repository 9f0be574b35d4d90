"""Units: scenes are in mm, people meet coefficients in 1/cm."""

#: Millimetres per centimetre; coefficients are converted once, where a scene is read.
MM_PER_CM = 10.0
