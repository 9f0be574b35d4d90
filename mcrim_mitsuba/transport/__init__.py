"""Light through a loaded scene: all that imports Mitsuba and Dr.Jit.

A scene file becomes a `Simulation`, whose `Launcher` sends photons through it, many at a time in
the processor's vector registers; what becomes of them is tallied, recorded or drawn. Other rooms
may take

- at any time: `simulation` (`Simulation`, the front door), `launch_plan` (`LANES`, `SHARE_STEPS`,
  `BATCHES`, `FateTally`, `PhotonRecords`: what a fit gets, and asks for), `check` (is a scene
  sound, and what does it mean), `scene_model` (a scene in numbers), `cut`, `photograph_parts`
  (a bench drawn), `variants` (which Mitsuba, LLVM or GPU, and their versions);
- inside functions, after `variants.use_variant`, because they import Mitsuba: `collection`
  (`Launcher`, `Recorder`, `collect`, `follow_trails`), `arrivals` (where light arrives),
  `photograph`.

The rest is private: `loop` (a step in photons' lives), two paths through a scene (`flat_path` with
`convex` and `folding`, and `general_path`), `surface_physics`, `bulk` (births and scattering),
`record_store`, `volume_consistency`, `plugins`, and `conversion` (a Mitsuba scene becomes numbers).
"""
