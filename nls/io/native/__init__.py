"""The library's own file, `native`: every graph bit for bit, as arrays (``.npz``) or as text for people (``.json``)."""
