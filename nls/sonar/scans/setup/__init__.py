"""Whether a scan mission is set up as it says: the side of the azimuths, the mounting, the clock, the sigmas."""
