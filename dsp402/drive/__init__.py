"""The client of a CiA 402 drive: start-up, guarding, process images and touch probe."""
