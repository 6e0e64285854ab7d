"""The polar of a vehicle: what steady flight costs at each airspeed, payload and wind."""
