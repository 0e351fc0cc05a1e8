"""Real recordings counted beside: answer keys, black-box models, table."""
