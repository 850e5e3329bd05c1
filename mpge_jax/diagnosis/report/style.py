"""The look of the pages: light and dark as the reader's system is set, and plain on paper."""

STYLE = """
:root{color-scheme:light dark;--ink:#1b1b1b;--quiet:#555;--ground:#fff;--line:#ddd;--code:#f4f4f4;--amber:#9a6700;
--added:#1d6b35;--removed:#a3271d}
@media (prefers-color-scheme:dark){:root{--ink:#e6e6e6;--quiet:#a9a9a9;--ground:#16181b;--line:#3a3d42;--code:#23262b;
--amber:#d9a03c;--added:#7fd197;--removed:#f19a8f}
img{filter:invert(.91) hue-rotate(180deg);border-radius:.25rem}}
body{font:16px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--ground);margin:0}
main{max-width:60rem;margin:0 auto;padding:2rem 1.25rem 4rem}
h1{font-size:1.15rem;color:var(--quiet);margin:0 0 .5rem;font-weight:600}
.lead{font-size:1.45rem;line-height:1.35;margin:.2rem 0 1.2rem;font-weight:600}
h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
.badge{display:inline-block;padding:.1rem .6rem;border-radius:1rem;color:#fff;font-size:.85rem;font-weight:600}
.effects{background:#1f6fb2}
.none{background:#2d7d46}
.ambiguous{background:#9a6700}
.unexplained{background:#b3261e}
table{border-collapse:collapse;width:100%;font-size:.94rem}
th,td{text-align:left;padding:.35rem .7rem .35rem 0;border-bottom:1px solid var(--line);vertical-align:top}
td.within{border-bottom-color:transparent}
img{max-width:100%;height:auto}
figure{margin:0}
pre{white-space:pre-wrap;overflow-wrap:anywhere;background:var(--code);padding:.6rem .8rem;font-size:.85rem}
ins,del{text-decoration:none}
ins{color:var(--added)}
del{color:var(--removed)}
a{color:inherit}
.row{display:flex;flex-wrap:wrap;gap:1.5rem;align-items:flex-start}
.row>*{flex:1 1 20rem;min-width:0}
.row h2:first-child{margin-top:.6rem}
.numbers{display:flex;flex-wrap:wrap;gap:1.2rem;margin:.6rem 0 1rem}
.numbers div{min-width:6.5rem}
.numbers b{display:block;font-size:1.35rem}
small,.quiet{color:var(--quiet)}
.warnings{border-left:.25rem solid var(--amber);padding:.1rem 0 .1rem .9rem;margin:1rem 0}
.warnings ul{margin:.2rem 0;padding-left:1.1rem}
.overflow{overflow-x:auto}
@media print{:root{--ink:#000;--quiet:#444;--ground:#fff;--line:#bbb;--code:#f4f4f4;--amber:#9a6700;--added:#1d6b35;
--removed:#a3271d}
body{font-size:10.5pt}
main{max-width:none;padding:0}
img{filter:none;break-inside:avoid}
h2{break-after:avoid}
tr,figure,.numbers{break-inside:avoid}
.overflow{overflow:visible}
.badge{print-color-adjust:exact;-webkit-print-color-adjust:exact}
.row>*{flex-basis:14rem}}
"""
