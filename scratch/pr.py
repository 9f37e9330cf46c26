from base import *
import patch
from lpvguard.engine.synthesis import knot_search as ks
from lpvguard.engine.synthesis.storage_grid import refined
d=cached('Dq_56.0_4.9e-07',None); sch,*_=K(100.0,1e-6)
s=with_settings(STORED,A_t=56.0,A_u=4.9e-7)
fam=ms.scaled_families(s,sch,d)['performance']
gain,fg=ll._least_gain(fam,(2,2),1.0)
wide=ll.weighed(fam,(2,2),1.0,gain)
rate,basis,kn,point,*_=pickle.load(open(sys.argv[1],'rb'))
best=gain*np.sqrt(1+point.excess); one=ll.weighed(fam,(2,2),1.0,best)
st=lc.Storage(basis,kn,point.P,False)
fine=refined(wide.nodes,16)
grid=ks.KnotGrid(wide.loop,wide.Ts,kn,fine,basis,(2,2),np.eye(len(basis)))
for r in (0.0,0.1,0.25,0.5,0.75,0.9,1.0):
    low=np.linalg.eigvalsh(grid.F(point,r))[:,0]
    print(r,'between: least F',low.min(),(low<=0).sum(),len(low),flush=True)
for r in [float(x) for x in sys.argv[2].split(',')]:
    t=time.process_time(); p=lc.prove(one,st,r); print('prove',r,p,time.process_time()-t,flush=True)
    if p: break
