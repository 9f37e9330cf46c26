"""From a stored P: the search of least_level at one rate on the grid, then the proof at 1 m/s2."""
from base import *
from lpvguard.engine.synthesis import knot_search as ks
from lpvguard.engine.synthesis.storage_grid import refined
src,on_grid,out=sys.argv[1],float(sys.argv[2]),sys.argv[3]
sch,sc,worst,full=K(100.0,1e-6)
s=with_settings(STORED,A_t=56.0,A_u=4.9e-7)
d=cached('Dq_56.0_4.9e-07',None)
fam=ms.scaled_families(s,sch,d)['performance']
gain=cached('gain56',lambda: ll._least_gain(fam,(2,2),1.0))[0]
wide=ll.weighed(fam,(2,2),1.0,gain)
b00,parts,frozen=cached('frozen56',lambda: (lambda f:(f[0],None,f[2]))(lc.frozen_at(wide,wide.nodes)))
rate,basis,kn,point,*_=pickle.load(open(src,'rb'))
Ti=np.linalg.inv(np.linalg.solve(b00,basis)); cost=ll.COST*Ti@np.linalg.inv(frozen.mean(axis=0))@Ti.T
t0=time.process_time()
nsold=ks.newton_step
def ns(b,P,y,directions,slope,price):
    r=nsold(b,P,y,directions,slope,price)
    pickle.dump((on_grid,grid.basis,grid.knots,ks.Point(r[0],float(r[1][-1])),r[1]),open(out+'_step.pkl','wb'))
    print('  ',P.shape[0],len(b.M),'y',np.round(r[1],5),f'dec {r[2]:.3g} cpu {time.process_time()-t0:.0f}',time.strftime('%H:%M:%S'),flush=True); return r
ks.newton_step=ns
grid=ks.KnotGrid(wide.loop,wide.Ts,kn,refined(kn,ll.SPEED_PARTS),basis,(2,2),cost)
grid,point=grid.evened(point)
for rnd in range(6):
    print('speeds',len(grid.speeds),'on grid',on_grid,flush=True)
    point=ks.found_at(grid,point,on_grid,np.eye(len(basis)+7))
    if point is None: print('none'); break
    pickle.dump((on_grid,grid.basis,grid.knots,point,0),open(out+'.pkl','wb'))
    best=gain*np.sqrt(1+point.excess); t=time.process_time()
    pr=lc.prove(ll.weighed(fam,(2,2),1.0,best),lc.Storage(grid.basis,grid.knots,point.P,False),1.0)
    print('proof',pr,'cpu',time.process_time()-t,flush=True)
    if pr: break
    j=grid.violated(point,on_grid,refined(wide.nodes,lc.KNOTS)); print('joined',j,flush=True)
    if not len(j): break
    grid=grid.asked_at(j); grid,point=grid.evened(point)
