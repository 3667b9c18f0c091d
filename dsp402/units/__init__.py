"""Units of positions, velocities and accelerations as exact fractions, and the scaling."""
