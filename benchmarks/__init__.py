"""What measures this package: peers, test collections, ablations, demonstrations."""
