"""The leaf: archives, bundles, catalogues and the stores for them. Knows no HTTP server, no torch, no captures."""
