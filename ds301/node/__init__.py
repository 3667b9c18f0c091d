"""One CANopen node as its client sees it: start-up, configuration, PDO plan, SDO access and supervision."""
