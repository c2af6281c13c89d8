"""The table in software: plant, cameras, boards and air waves behind the core Protocols."""
