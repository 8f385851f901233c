"""A file on which Arrow ends the process is refused in words by commands and by the library, as by the service."""

from __future__ import annotations

import base64
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from joulemap.model.errors import RunsError
from joulemap.service.intake.trial import refuse_deadly
from joulemap.service.library.run_files import read_runs
from tests.fuzz.files import parquet

DEADLY = zlib.decompress(
    base64.b85decode(
        b"c-qyLS!^3c7{_Prjbl6B#yMuQo7jodCL6nn)0`!Q1bdys&DAD>Pyzv(!*SZ?s&jKS+~qE%NWfEhK_KOUCq!R(C@*c)N{C8Gg+3ID"
        b"DhgGV(sG~Q?2esHJB8+vk$*F@-+cRh^Nr_kxl`>f$2>llj=!_D<0TVD=?HybLrCEGx8LG8{%F8vb({!PRdO6UEjalz0b3C|CrFO-"
        b"f#@*UE(jjS#lWePFuf#r(TX6UD?%B%DtOQ}p$7c~wqJl>f!~2YfWHJUkAk*cq&vcMLE9p43fkV|&G3kLa3CZB79bh0Qfz=7NC6xa"
        b"K|mQWWE#K}(LfeOG9Xj34dhT<2Hccf19=pWzYKW<f(NJpyeOZ+Mh2UNgMfDp1q=!qC=7}icp3N@Y-Ui*poD>cl>&e8)Jf9(L5%P*"
        b"6J9ozkXz-%7Hn}z*7%}iMS5Elk(XgjON0I$Zsmv>#w8PHEkc~h%qLlrtu}j#L)eh&OiRzm#A22tXXm)wxp|)ajhhMzl_IZib8(5k"
        b"bW2%zMP*g>*4t`suf3zL{?0&94K*}2HHWvgw6?W(Y~Rt@)qU69J@@RqxA(sL`yP1kp<Vq0gF}(w=*aFpdq>B{CnopBrlx0R=jIn4"
        b"e&o@|9^b$C#FI}w{miq^9eDnQ7hih$l~)hGcIfrPZy=<L=Mq~y?-TJH)y4A(i01?m&!-@s)4F&*2l1TI#d8)85M+hEg3ELsF4H$~"
        b"nJ$3sTi_z_JwOC@nTl)${H}oC58!tdY}Y710z`B_Q{lzM_nSe0gg<p5qQ3>N6$PXDsn%f>^jTqEnZ$u8eVwEWA`|!kpitikGQ)$J"
        b"3e+gnxL7R)(Heyt7jIm^c7u?OV%7z%v%x?r#R+P23Iq>O19(vygLDQNptcNcTqTnMW*{=iVjwY)8DulaVc=rmUZucI)#m;;wYiyU"
        b"bN^q}=ERxpSeKgBMJqs1zKFBe6dzw&Tl|eyt@so#EuC93-7HD)=1Er1GH6I*uriV$+=^?oU`P+faT15bA+I)SFBG~mp)VTy^21s)"
        b"s`B?3S`y~v(P|`FrUpkMWBu5Uu)WYEanp31r{jV?CJ)ZUVv%uJMexLrO~fKdTr$ZnxlchZY?rH%#VNz<*aT+rxF~)hD2MHeb$!3t"
        b"atWLr!di7s80vf$S%HdSc}<%6M4GdLvXZ5IEv)ah-fEr&J<l;tT;`O^Im*X5>$@1Ym?wU^#%v$Cl>_ee-H`vthU7vElJzf7&vb|r"
        b"7dhp#+`1d?jtuTvs5)P<tPCCJAcpvEIlQD;#pOI$mmF$$_l}*l`u&mKG;bkoAsSLuwM*4oo2t&Kp{Uxds!_Ees@X!|&_N~*s@kF%"
        b"R!3+(K%=(4mvmt*R9RxZc@HG1fk{)iNi)uozDZ3q;vbqGsB9gLKZof0NGH5X+`Bropy7nS-n3BR?d5~xt)m0uU20^O`bQh)NNL&@"
        b"<`bKw`&ARu2np5JPWRWMR$P~_`MP}CbQ?L8#x@$ifkbN7&ZC#?r-K&PmB^##?`7p5(n^Yw^A1xx9C3X;l01|Bv3)a<Y5(Blq`yBF"
        b"o0#*=Mq*RDC&oP$TT9DI%jG`!jWT{vE{{+r{I&lF`t}vh"
    )
)
"""A Parquet file of `tests.fuzz` (seed 0, number 1500), in which some bytes were changed."""

READ = """
import sys
from pathlib import Path
from joulemap.model.runs.reader import read_run
read_run(Path(sys.argv[1]))
"""


@pytest.fixture
def deadly(tmp_path: Path) -> Path:
    place = tmp_path / "b.parquet"
    place.write_bytes(DEADLY)
    ended = subprocess.run([sys.executable, "-c", READ, str(place)], capture_output=True).returncode
    if ended >= 0:
        pytest.skip("this version of Arrow bears the file")
    return place


def test_it_is_told_and_the_process_goes_on(deadly: Path) -> None:
    t = [0.1 * k for k in range(50)]
    good = deadly.with_name("a.parquet")
    good.write_bytes(parquet({"t": t, "x": t, "y": t, "current": t, "voltage": t}))
    with pytest.raises(RunsError, match=r"run b\.parquet: reading it ends the process \(SIGABRT\)"):
        read_runs(deadly.parent)
    refuse_deadly([good])
    assert len(read_runs(good)) == 1


def test_a_command_says_so(deadly: Path) -> None:
    command = [sys.executable, "-m", "joulemap.service.cli", "heightmap", "--from-runs", str(deadly), "--out", "x.tif"]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=deadly.parent)
    assert ended.returncode == 3, ended.stderr
    assert "the Parquet file is corrupt" in " ".join(ended.stderr.split())
