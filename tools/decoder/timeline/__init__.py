"""Timeline: records of both buses in the order of time, with causes."""
