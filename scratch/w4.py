from base import *
from lpvguard.engine.synthesis import knot_search as ks
from lpvguard.engine.synthesis.storage_grid import refined
A_t,A_u,src,rate=56.0,4.9e-7,sys.argv[1],float(sys.argv[2])
sch,sc,worst,full=K(100.0,1e-6)
s=with_settings(STORED,A_t=A_t,A_u=A_u)
d=cached(f'Dq_{A_t}_{A_u}',None)
fam=ms.scaled_families(s,sch,d)['performance']
gain,fg=ll._least_gain(fam,(2,2),1.0)
wide=ll.weighed(fam,(2,2),1.0,gain)
b00,parts,frozen=lc.frozen_at(wide,wide.nodes)
_,basis,kn,point,*_=pickle.load(open(src,'rb'))
Ti=np.linalg.inv(np.linalg.solve(b00,basis)); cost=ll.COST*Ti@np.linalg.inv(frozen.mean(axis=0))@Ti.T
t0=time.process_time(); w0=time.time(); H={}
nsold=ks.newton_step
def ns(b,P,y,directions,slope,price):
    r=nsold(b,P,y,directions,slope,price)
    pickle.dump((rate,H['grid'].basis,H['grid'].knots,ks.Point(r[0],float(r[1][-1])),r[1]),open('w2_step.pkl','wb'))
    print('  ',P.shape[0],len(b.M),'y',np.round(r[1],5),f'dec {r[2]:.3g} w {slope[:1]/max(1,len(b.M)*b.constant.shape[-1])} cost {price@np.concatenate([Q[b.upper] for Q in r[0]]):.3g} cpu {time.process_time()-t0:.0f} wall {time.time()-w0:.0f}',flush=True); return r
ks.newton_step=ns
grid=ks.KnotGrid(wide.loop,wide.Ts,kn,kn,basis,(2,2),cost)
F=np.linalg.eigvalsh(grid.F(point,rate))[:,0]; print('start knots',len(grid.knots),'least F',F.min(),flush=True)
fine=refined(wide.nodes,16); first=True
def rep(tag):
    Z=np.linalg.eigvalsh(grid.F(point,0.0))[:,0]; R=np.linalg.eigvalsh(grid.F(point,rate))[:,0]; print(tag,'rate 0: not PD',(Z<=0).sum(),Z.min(),'rate',(R<=0).sum(),R.min(),len(R),flush=True)
grid=replace(grid,speeds=refined(wide.nodes,int(sys.argv[3])))
if True:
    H['grid']=grid; rep('resume'); point=ks.found_at(grid,point,rate,np.eye(len(basis)+7)); 
    if point is None: print('none'); sys.exit()
    pickle.dump((rate,grid.basis,grid.knots,point,0),open('w2_ok.pkl','wb'))
for rnd in range(5):
    best=gain*np.sqrt(1+point.excess); t=time.process_time()
    pr=lc.prove(ll.weighed(fam,(2,2),1.0,best),lc.Storage(grid.basis,grid.knots,point.P,False),1.0)
    print('proof',pr,time.process_time()-t,flush=True)
    if pr:
        f=lc.LpvCertificate(1.0,lc.Storage(grid.basis,grid.knots,point.P,False),None,pr,None,1.0,best,own_knots=True)
        pickle.dump((d,f),open('q_56.0_4.9e-07.pkl','wb')); break
    if len(grid.knots)==12: j=np.setdiff1d(refined(wide.nodes,2),grid.knots)
    else: j=grid.violated(point,rate,fine)
    print('joined',j,flush=True)
    if not len(j): break
    grid,point=grid.evened(point); grid,point=grid.joined_by(point,j); H['grid']=grid
    point=ks.found_at(grid,point,rate,np.eye(len(basis)+7))
    if point is None: print('none'); break
