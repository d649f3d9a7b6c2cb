"""AirSim's RPC API, server and client: programs for AirSim fly our vehicle, our pipeline flies a server's vehicle."""
