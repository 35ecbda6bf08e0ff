"""The missing force: splines inside the equation of motion, and symbolic forms of it."""
