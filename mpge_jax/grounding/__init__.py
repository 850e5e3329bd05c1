"""Action transformers: trained adversarially or by inversion, judged, and put before a simulator."""
