"""Plans of many runs, a runner that gives each a process, and tables of what came out beside the paper's."""
