"""Whether a solved pose graph is at its global optimum, by a proof in the SE-Sync cost; or a better one."""

from nls.certificate.verdict import Certificate, certify

__all__ = ["Certificate", "certify"]
