"""The paper reproduced: its experiments under every power model, and what its claims rest on."""
