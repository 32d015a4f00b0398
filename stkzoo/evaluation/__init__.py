"""Many races: batches, benchmarks, tournaments, ratings and demonstrations."""
