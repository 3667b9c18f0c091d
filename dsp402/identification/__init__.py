"""What kind of drive it is: data sheet, answers of the device and the overlay of its family."""
