"""One page that shows a solution: a file of HTML with its pictures inside, for the screen, a phone and paper."""

from nls.plot.report.page import report

__all__ = ["report"]
