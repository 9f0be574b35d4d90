"""All that imports Mitsuba: plugins, the loop, photon records, traced checks, photographs."""
