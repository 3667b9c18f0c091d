"""Units of a drive: positions, velocities and accelerations, as exact fractions, and the scaling made of them."""
