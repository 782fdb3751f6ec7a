"""`reach` and `workspace`: inverse kinetostatics, the actuation for a target."""
