"""Values kept as documents: parameter sets, replacing a unit, recipes, the change tray."""
