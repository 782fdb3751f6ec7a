"""`fit`: parameters from measurements, and how well the measurements determine them."""
