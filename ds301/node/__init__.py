"""The client of one CANopen node: start-up, configuration, PDO plan, SDO access and supervision."""
