"""The nodes of this package: they read parameters, subscribe, call the core and publish."""
