"""Initial guesses of missions: beacons where their ranges meet, and tracks where their fixes put them."""
