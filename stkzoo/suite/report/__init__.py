"""Reports of training runs in the suite: result files, statistics, tables and figures."""
