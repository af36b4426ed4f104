"""What people see: text tables, figures, Meshcat."""
