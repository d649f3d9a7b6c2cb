"""AirSim's RPC API in both directions: programs for AirSim fly our vehicle, our pipeline flies a server of the API."""
