"""Lower bounds: how far an answer is from the best one, at most."""

from drake_aigto.certify.certificate import Certificate, Certifier, Method, certify, relative_gap

__all__ = ["Certificate", "Certifier", "Method", "certify", "relative_gap"]
