"""What supervises an axis: sign of life, stops, enables, velocity and the drive's own events."""
