"""The parametrised model: uncertain parameters, locations, observed channels."""
