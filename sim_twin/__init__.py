"""The simulated table: plant, cameras, boards and radio behind the core Protocols."""
