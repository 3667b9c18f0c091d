"""The PDOs of a drive: which object travels in which, planned from what the drive has, and the check of its values."""
