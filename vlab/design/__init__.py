"""Design of control laws on models of a structure: weights, Riccati equations, closed loops and their performance."""
