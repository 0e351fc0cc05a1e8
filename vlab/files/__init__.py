"""Files at the edge: TOML schemas, assets, output folders, locks."""
