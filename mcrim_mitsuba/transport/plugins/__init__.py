"""What a scene file names: shapes, BSDFs, media, emitter and integrator."""
