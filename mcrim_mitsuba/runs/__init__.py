"""Long jobs as units of work: who does them (this process, Dask, an array job), and the cache."""
