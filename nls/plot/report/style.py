"""How the page looks: light and dark as the reader's system is, on a phone, and printed.

Every rule is about the inside of the page, so that it changes nothing else in a notebook that shows it.
"""

__all__ = ["STYLE"]

# Pictures are drawn for a white page; in the dark they are turned over, with their hues kept.
STYLE = """
body:has(> .leadline) { margin: 0; background: #ffffff; }
.leadline { color-scheme: light dark; --page: #ffffff; --text: #1b1f23; --quiet: #59636e; --line: #d5dade;
  --card: #f4f6f8; --good: #1a7f37; --warn: #9a6700; --bad: #c1121f; --ink: #0b4f6c; --hot: #d2601a; }
@media screen and (prefers-color-scheme: dark) {
  body:has(> .leadline) { background: #1a1a1a; }
  .leadline { --page: #1a1a1a; --text: #e8e8e8; --quiet: #a3acb5; --line: #3c4248; --card: #25282b; --good: #4ac26b;
    --warn: #e0a82e; --bad: #ff7b72; --ink: #7cc4e0; --hot: #f0a060; }
  .leadline img { filter: invert(0.898) hue-rotate(180deg); }
}
.leadline, .leadline * { box-sizing: border-box; }
.leadline { margin: 0 auto; padding: 1rem; max-width: 70rem; background: var(--page); color: var(--text);
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", "Noto Sans", sans-serif; }
.leadline .file { margin: 0; color: var(--quiet); overflow-wrap: anywhere; }
.leadline h1 { margin: 0.3rem 0 0.6rem; font-size: 1.45rem; line-height: 1.3; font-weight: 600;
  overflow-wrap: anywhere; }
.leadline h2 { margin: 2.2rem 0 0.6rem; padding-bottom: 0.2rem; font-size: 1.15rem; font-weight: 600;
  border-bottom: 1px solid var(--line); }
.leadline .verdict { display: inline-block; margin-right: 0.4rem; padding: 0.05rem 0.6rem; border-radius: 1rem;
  font-size: 1.1rem; color: var(--page); }
.leadline .good { background: var(--good); }
.leadline .warn { background: var(--warn); }
.leadline .bad { background: var(--bad); }
.leadline nav { font-size: 0.9rem; margin: 0.4rem 0; }
.leadline nav a { margin-right: 0.9rem; white-space: nowrap; }
.leadline a { color: var(--ink); }
.leadline .figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: 0.5rem; }
.leadline .figures > div { background: var(--card); border-radius: 0.4rem; padding: 0.4rem 0.7rem; }
.leadline .figures dt { color: var(--quiet); font-size: 0.85rem; }
.leadline .figures dd { margin: 0; font-size: 1.05rem; font-weight: 600; overflow-wrap: anywhere; }
.leadline .figures small { display: block; color: var(--quiet); font-weight: 400; font-size: 0.8rem; }
.leadline .facts > div { display: flex; gap: 0.8rem; padding: 0.15rem 0; border-bottom: 1px solid var(--line); }
.leadline .facts dt { flex: 0 0 8.5rem; color: var(--quiet); }
.leadline .facts dd { margin: 0; overflow-wrap: anywhere; min-width: 0; }
.leadline .pictures { display: flex; flex-wrap: wrap; gap: 0.8rem 2rem; align-items: flex-start; }
.leadline figure { margin: 0; flex: 1 1 20rem; min-width: 0; max-width: 34rem; overflow-x: auto; }
.leadline .wide { flex-basis: 100%; max-width: none; }
.leadline .wide img { min-width: 38rem; }
.leadline img { display: block; width: 100%; height: auto; max-height: 92vh; object-fit: contain; background: #ffffff; }
.leadline figcaption { color: var(--quiet); font-size: 0.9rem; }
.leadline .scroll { overflow-x: auto; margin: 0.6rem 0; min-width: 0; max-width: 100%; }
.leadline table { border-collapse: collapse; min-width: 50%; }
.leadline caption { text-align: left; color: var(--quiet); font-size: 0.9rem; padding-bottom: 0.3rem; }
.leadline th, .leadline td { padding: 0.25rem 0.8rem 0.25rem 0; text-align: left; font-weight: 400;
  border-bottom: 1px solid var(--line); }
.leadline thead th { color: var(--quiet); font-size: 0.85rem; vertical-align: bottom; }
.leadline .number { text-align: right; font-variant-numeric: tabular-nums; }
.leadline td.number { white-space: nowrap; }
.leadline li { margin-bottom: 0.7rem; overflow-wrap: anywhere; }
.leadline li p, .leadline .lines { margin: 0; overflow-wrap: anywhere; }
.leadline .quiet { color: var(--quiet); }
.leadline svg { display: block; width: 13rem; height: 1.3rem; }
@media (max-width: 40rem) {
  .leadline h1 { font-size: 1.2rem; }
  .leadline .figures { grid-template-columns: 1fr 1fr; }
  .leadline .facts > div { display: block; }
  .leadline svg { width: 8rem; }
}
@media print {
  .leadline { max-width: none; font-size: 10pt; }
  .leadline nav { display: none; }
  .leadline figure, .leadline tr, .leadline li { break-inside: avoid; }
  .leadline h2 { break-after: avoid; }
  .leadline img { max-height: 16cm; }
  .leadline .wide img { min-width: 0; }
  .leadline .verdict { border: 1px solid; color: inherit; background: none; }
}
"""
