"""Long work in units: who does them, where what they made is kept, and by which key.

A unit says itself all that its result depends on; so it may be made by this process, by a worker
of a Dask cluster or by a part of an array job, and is never made twice. Other rooms may take

- `executors` (`WorkItem`, a unit; `Job`, a unit and where it is kept; `Executor`, `use_executor`:
  who does the jobs of a block of code), `cluster` (`ClusterExecutor`) and `array_job`
  (`PartExecutor`, `MergingExecutor`, `UnitFolder`);
- `scene_units` (`SceneUnit`, `LaunchBlock`: bases of units that simulate; `planned`);
- `cache` (`RecordCache`: chunks by number, for one key; hashes of code and input).

`cache_files`, what a chunk is as a file and how the cache is kept tidy, is private.
"""
