"""Whether a solved pose graph is the best there is: a certificate of global optimality, or a better one."""

from nls.certificate.verdict import Certificate, certify

__all__ = ["Certificate", "certify"]
