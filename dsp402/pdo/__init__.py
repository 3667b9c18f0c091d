"""PDO layouts, and their plan for one drive."""
