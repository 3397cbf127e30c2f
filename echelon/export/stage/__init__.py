"""The parts of an OpenUSD stage, one a file; `echelon.export.usd` and `echelon.export.physics` put them together."""
