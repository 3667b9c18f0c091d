"""PDO layouts, the planner that adapts them to a drive, and the check of values."""
