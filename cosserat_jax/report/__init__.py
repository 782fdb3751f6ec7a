"""Floor 5, show: xarray datasets and figures."""
