"""Design of control laws: weights, Riccati equations, performance."""
