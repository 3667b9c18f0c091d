"""The type of a drive from data sheet, SDO answers, configuration and the overlay of its family."""
