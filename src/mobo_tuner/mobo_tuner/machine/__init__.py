"""What every machine's node serves: the server of its interfaces, and what is behind them. Without the optimiser."""
