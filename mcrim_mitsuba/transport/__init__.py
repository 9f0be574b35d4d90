"""All that imports Mitsuba: plugins, the loop, photon records, checks that trace lines, photographs."""
