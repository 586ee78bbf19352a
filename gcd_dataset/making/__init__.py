"""Making data sets, shard by shard: by a pool of processes, by jobs of an array, or by the tasks of a Ray cluster."""
