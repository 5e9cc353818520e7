"""What only missions begin with: beacons where their ranges meet, and tracks where their fixes put them."""
