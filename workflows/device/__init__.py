"""One measured device, for commands and notebooks: its measurement, what was checked and what was identified."""
