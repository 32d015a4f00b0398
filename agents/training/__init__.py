"""Programs that train and tune drivers."""
